"""One mission of the authors' stack through the contract: ``function: tuner.bridges.photogrammetry_nbv.flying:fly``.

Never run against the stack itself, which was not to be had; the tests fly a stand-in that behaves as its sources say.
"""

from __future__ import annotations

import shutil
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from nbv.config import MissionConfig
from nbv.errors import UserError
from nbv.safe_files import MIB, read_bytes
from tuner.bridges.photogrammetry_nbv.configuring import configuration, files_beside
from tuner.bridges.photogrammetry_nbv.files import write_text
from tuner.bridges.photogrammetry_nbv.result import MissionUnfinishedError, read_run
from tuner.bridges.photogrammetry_nbv.stack import Stack, StackError, running
from tuner.bridges.photogrammetry_nbv.writing import write_mission, write_scoring

NODE = "node"  # the program that flies
_START_LIMIT_S = 300.0
_POLL_S = 0.2
_LARGEST_LOG_BYTES = 256 * MIB  # of one program; a mission's log of theirs has some 100 kB


def fly(request: dict[str, Any]) -> dict[str, Any]:
    """Fly one mission; the cloud with its cameras, or whose failure it is."""
    if request.get("check") == "fail":
        return _failure("configuration", "asked_to_fail", "")
    facts, output = request["instance"], Path(request["output"])
    stack = facts.get("stack")
    if not isinstance(stack, dict) or NODE not in stack.get("start", {}):
        return _failure("machine", "no_stack", "the instance has no stack.start.node: what shall be started?")
    try:
        files_beside(Path.cwd())
    except UserError as error:  # the same for every configuration: it says nothing about this one
        return _failure("machine", "their_files", str(error))
    try:
        config = configuration(request["configuration"], facts.get("set", {}), Path.cwd())
        files = write_files(config, stack, request.get("resources", {}), output, Path.cwd())
        environment = {str(k): str(v) for k, v in stack.get("environment", {}).items()}
        environment["GATETUNE_CONFIG"] = str(output / "gatetune.yaml")
        places = {**request.get("resources", {}), **files}
        with running(stack["start"], environment, places, output / "logs") as programs:
            run = _watch(programs, files["runs"], config, stack)
        cloud, cost = read_run(run, facts, stack, config.target_m, Path.cwd())
    except (StackError, OSError) as error:
        return _failure("machine", "stack", str(error))
    except UserError as error:
        return _failure("configuration", "not_expressible", str(error))
    except MissionUnfinishedError as error:
        return _failure(error.whose, error.reason, str(error))
    artefacts = {"scoring": "scoring.yaml", "mission": "unified_mission.yaml", "remarks": "remarks.txt"}
    return {"cloud": cloud, "cost": cost, "artefacts": artefacts}


def _failure(of: str, reason: str, message: str) -> dict[str, Any]:
    return {"failure": {"of": of, "reason": reason, "message": message}}


def write_files(
    config: MissionConfig, stack: Mapping[str, Any], resources: Mapping[str, Any], output: Path, folder: Path
) -> dict[str, Path]:
    """Their files for this mission in ``output``; paths by the names that commands may use in braces."""
    theirs = files_beside(folder)
    registered = bool(stack.get("node_ends"))  # our node: our scorers, from gatetune.yaml
    if registered:
        scoring, remarks = write_scoring(config.with_values({"gate.kind": "covis"}), theirs["scoring.yaml"])
        scoring["name"], remarks = "gatetune", []
    else:
        scoring, remarks = write_scoring(config, theirs["scoring.yaml"])
    mission, more = write_mission(config, theirs["unified_mission.yaml"])
    files = {"scoring": output / "scoring.yaml", "mission": output / "unified_mission.yaml"}
    files |= {"runs": output / "runs", "scripts": output / "colmap_scripts"}
    mission |= {"output_root": str(files["runs"]), "scoring_config_path": str(files["scoring"])}
    if scripts := stack.get("colmap_script_dir"):  # they leave their requests in it (colmap_worker_client.py)
        shutil.copytree(Path(scripts).expanduser(), files["scripts"])
        mission["colmap_script_dir"] = str(files["scripts"])
    own = folder / "colmap.yaml"
    if own.is_file() or stack.get("colmap_config"):
        mission["colmap_config_path"] = str(
            own if own.is_file() else Path(stack["colmap_config"]).expanduser()
        )
    if instance := int(resources.get("PX4_INSTANCE", 0)):  # PX4 puts all but the first into a namespace
        for key, value in mission.items():
            if key.endswith("_topic") and str(value).startswith("/fmu/"):
                mission[key] = f"/px4_{instance}{value}"
    files["runs"].mkdir(parents=True)
    files["scoring"].write_text(write_text(scoring, "scoring.yaml"), encoding="utf-8")
    files["mission"].write_text(write_text(mission, "unified_mission.yaml"), encoding="utf-8")
    (output / "remarks.txt").write_text("".join(f"{r}\n" for r in (*remarks, *more)), encoding="utf-8")
    (output / "gatetune.yaml").write_text(yaml.safe_dump(config.to_dict()), encoding="utf-8")
    return files


def _watch(programs: Stack, runs: Path, config: MissionConfig, stack: Mapping[str, Any]) -> Path:
    """Wait until the node has written its last file; the run's folder.

    The node never ends by itself, and an error lands and reconstructs, too: only the files and its log tell. The contract's
    time limit ends a mission that hangs.
    """
    deadline = time.monotonic() + float(stack.get("start_limit_s", _START_LIMIT_S))
    while True:
        run = next(iter(sorted(runs.glob("unified_run_*"))), None)
        if run is not None and _complete(run / "final"):
            _require_full(run, programs.log(NODE), config)
            return run
        for name, status in programs.ended().items():
            if status == 0 and name != NODE:
                continue  # a launcher that hands over
            raise StackError(
                f"{name} ended with status {status} in the middle of the mission; see {programs.log(name)}"
            )
        if flooded := programs.flooded(_LARGEST_LOG_BYTES):
            raise StackError(f"{flooded} floods its log; lower its log level; see {programs.log(flooded)}")
        if run is None and time.monotonic() > deadline:
            raise StackError(
                f"nothing moves: the node made no folder in {runs}; run px4-sitl-doctor; see {programs.log(NODE)}"
            )
        time.sleep(_POLL_S)


def _complete(final: Path) -> bool:
    """Whether the last file, the seeds' cloud, is written: after the dense one, also where that failed."""
    last = final / "seed_sparse_cloud.ply"
    return last.is_file() and last.stat().st_size > 0


def _require_full(run: Path, log: Path, config: MissionConfig) -> None:
    """That the mission ended because it was done; their node says which in its log alone."""
    said = read_bytes(log, 2 * _LARGEST_LOG_BYTES).decode(errors="replace")
    wanted, taken = config.adaptive_budget, len([*(run / "adaptive" / "images").glob("*.*")])
    if "No feasible candidates" in said:
        raise MissionUnfinishedError("configuration", "no_candidates", f"after {taken} photographs")
    if taken < wanted and "Stopping:" not in said:
        raise MissionUnfinishedError(
            "machine", "landed_early", f"{taken} of {wanted} adaptive photographs; see {log}"
        )
    if not (run / "final" / "dense_cloud.ply").is_file():
        raise MissionUnfinishedError("machine", "no_dense_cloud", f"dense reconstruction failed; see {log}")
