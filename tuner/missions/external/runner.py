"""The fidelity ``external``: a mission of a mission file, flown and measured like one of ours."""

from __future__ import annotations

import contextlib
import errno
import tempfile
from pathlib import Path

from nbv.cache import Store
from nbv.errors import MissionFailure, UserError
from nbv.mission.function import Keep
from nbv.mission.result import MissionResult
from tuner.missions.external.configuration import ExternalConfig
from tuner.missions.external.contract import Failure, Request
from tuner.missions.external.flying import fly_request, require_no_fault_of_the_machine, tidy
from tuner.missions.external.scoring import mesh_sha256, score_cloud
from tuner.missions.external.slots import slots_of, take_slot

UNTIDY = "untidy_end"
HARDLY_OVERLAP = "hardly_overlap"  # cloud and mesh
OUTPUT = "output"  # of the mission, in its directory


def run_external_mission(
    config: ExternalConfig, rock: str, replicate: int, directory: Path | None, /, *, keep: Keep = "summary"
) -> MissionResult:
    """Fly one mission of a mission file; ``rock`` is one of its instances.

    Raises
    ------
    MissionFailure
        ``machine_error: ...``: the machine's failure; the mission says nothing about the configuration.
    UserError
        The mission file has changed, its command cannot be run, or ``config`` is none of a mission file.
    """
    if not isinstance(config, ExternalConfig):
        raise UserError("the fidelity external flies missions of a mission file; name one with --mission")
    try:
        return _run(config, rock, replicate, directory, keep)
    except (UserError, MissionFailure):
        raise
    except Exception as error:  # whatever the program did to its files is no fault of the configuration
        full = isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT)
        raise MissionFailure(
            "disk_full" if full else "machine_error: contract", f"{type(error).__name__}: {error}"
        ) from error


def _run(
    config: ExternalConfig, rock: str, replicate: int, directory: Path | None, keep: Keep
) -> MissionResult:
    mission = config.mission
    wait_s = mission.time_limit_s + mission.stop_grace_s
    with contextlib.ExitStack() as stack:
        if directory is None:
            directory = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        slot = stack.enter_context(take_slot(mission, slots_of(mission), wait_s))
        output = (directory / OUTPUT).absolute()
        request = Request(mission, directory.name, config.values, rock, replicate, output, slot)
        flown = fly_request(request)
        ended, result = flown.ended, flown.result
        require_no_fault_of_the_machine(result)
        failure, metrics, warning = result.failure, dict(result.metrics), ""
        if failure is None and result.cloud is not None and mission.score is not None:
            try:
                scored, warning = score_cloud(mission, rock, output, result.cloud, Store())
                metrics |= scored
            except MissionFailure as error:
                if error.reason.startswith("machine_error"):
                    raise
                # Nothing left of the cloud: the configuration's.
                failure = Failure("configuration", error.reason, error.message)
        if failure is None and keep == "summary":
            tidy(request, result)
        provenance = {"mission_file": str(config.file), "revision": f"mission file {config.sha256[:12]}"}
        if sha256 := mesh_sha256(mission, rock):
            provenance["rock_sha256"] = sha256
    notes = [f"ended with status {ended.status}"] if ended.status else []
    notes += [f"{ended.left_behind} processes outlived it and were ended"] if ended.left_behind else []
    notes += [f"{ended.survived} processes could not be ended"] if ended.survived else []
    notes += [warning] if warning else []
    if failure is not None:
        metrics, notes, reason = {}, [failure.message], failure.reason
    else:
        reason = HARDLY_OVERLAP if warning else UNTIDY if notes else ""
    return MissionResult(
        status="failed" if failure is not None else "degraded" if notes else "ok",
        reason=reason,
        message="; ".join(notes),
        config_digest=config.digest(),
        rock=rock,
        replicate=replicate,
        metrics=metrics,
        trace=[],
        timings_s={},
        costs={**result.cost, "wall_s": ended.wall_s},
        provenance=provenance,
    )
