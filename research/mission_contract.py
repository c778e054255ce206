"""The same campaign twice: our own missions built in, and as a mission file that anybody could have written.

    python -m research.mission_contract [--fidelity geometric] [--budget 48] [--set PATH=VALUE] [--out docs/results/data/mission_contract.csv]

Space `gate`, two rocks, GP, ``in_step`` 2, one worker. Each campaign has a store of its own, empty at the
start, so that neither finds what the other has made. Compared are all proposals and outcomes, number for number, and the time:
by the clock, and of the processor (children included), which a busy machine disturbs less.
"""

from __future__ import annotations

import argparse
import csv
import os
import resource
import tempfile
import time
from pathlib import Path
from typing import Any

import yaml

from nbv.config import preset
from nbv.threads import single_thread_environment
from tuner.campaign import Campaign, CampaignSettings, begin_campaign, fly_campaign
from tuner.missions import LocalProcessExecutor
from tuner.missions.external import load_mission_file
from tuner.problem.space_files import load_search_space

ROCKS = ("slab", "cavern")
METRIC = "observable.f_score_48mm"
FLY = '''
from nbv.config import preset
from nbv.FIDELITY import run_FIDELITY_mission

def plain(tree):
    """What a result may hold: numbers, and dictionaries of them."""
    kept = {k: plain(v) if isinstance(v, dict) else v for k, v in tree.items()}
    return {k: v for k, v in kept.items() if isinstance(v, (int, float, dict))}

def fly(request):
    config = preset("campaign").with_values({"gate.kind": "hyb-h", **SET, **request["configuration"]})
    result = run_FIDELITY_mission(config, request["instance"]["name"], request["replicate"])
    if result.status == "failed":
        return {"failure": {"of": "configuration", "reason": result.reason, "message": result.message}}
    return {"metrics": plain(result.metrics), "cost": plain(result.costs)}
'''


def mission_file(folder: Path, fidelity: str, overrides: dict[str, Any]) -> Path:
    """Our own missions as somebody else's."""
    space = load_search_space("gate")
    defaults = space.default(preset("campaign"))
    tree = {
        "schema": "gatetune.mission/1",
        "name": "gate",
        "function": "ours:fly",
        "parameters": {
            p.path: {
                "kind": p.kind,
                "low": p.low,
                "high": p.high,
                "scale": p.scale,
                "default": defaults[p.path],
            }
            for p in space.parameters
        },
        "instances": list(ROCKS),
        "replicates": 2,
        "metric": METRIC,
        "direction": "maximise",
    }
    (folder / "ours.py").write_text(FLY.replace("FIDELITY", fidelity).replace("SET", repr(overrides)))
    path = folder / "mission.yaml"
    path.write_text(yaml.safe_dump(tree, sort_keys=False))
    return path


def settings(
    way: str, folder: Path, fidelity: str, budget: int, overrides: dict[str, Any]
) -> CampaignSettings:
    """The campaign, with our fidelity or with the mission file."""
    common: dict[str, Any] = {
        "name": "parity",
        "rocks": ROCKS,
        "budget": budget,
        "replicates": 2,
        "in_step": 2,
    }
    if way == "built in":
        return CampaignSettings(
            space=load_search_space("gate"), fidelity=fidelity, overrides=overrides, **common
        )
    mission = load_mission_file(mission_file(folder, fidelity, overrides))
    return CampaignSettings(
        space=mission.space, fidelity="external", mission=mission, objective=mission.objective, **common
    )


def fly(
    way: str, folder: Path, fidelity: str, budget: int, overrides: dict[str, Any]
) -> tuple[list[tuple[Any, ...]], dict[str, Any]]:
    """Proposals and outcomes of one campaign, and what it took."""
    os.environ["GATETUNE_HOME"] = str(folder / f"home-{way}".replace(" ", "-"))
    asked = settings(way, folder, fidelity, budget, overrides)
    campaign: Campaign = begin_campaign(folder / way.replace(" ", "-"), asked)
    started, before = time.monotonic(), resource.getrusage(resource.RUSAGE_CHILDREN)
    with LocalProcessExecutor(1, 3600.0, preload=(asked.fidelity,)) as executor:
        summary = fly_campaign(campaign, executor)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    trials = campaign.trials()
    rows = [(t.rock, t.replicate, t.state, t.raw, *t.values.values()) for t in trials]
    cpu_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    wall_s = time.monotonic() - started - summary.ask_s
    return rows, {"missions": len(trials), "wall_s": wall_s / len(trials), "cpu_s": cpu_s / len(trials)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--fidelity", default="geometric", choices=("geometric", "photogrammetric"))
    parser.add_argument("--budget", type=int, default=48)
    parser.add_argument("--set", action="append", default=[], help="PATH=VALUE for every mission")
    parser.add_argument("--out", type=Path, help="CSV; rows are added to it")
    options = parser.parse_args()
    single_thread_environment()
    overrides = {
        path: yaml.safe_load(value) for path, _, value in (entry.partition("=") for entry in options.set)
    }
    with tempfile.TemporaryDirectory() as folder:
        flown = {
            way: fly(way, Path(folder), options.fidelity, options.budget, overrides)
            for way in ("built in", "contract")
        }
    (ours, own), (theirs, other) = flown["built in"], flown["contract"]
    same = sum(a == b for a, b in zip(ours, theirs))
    row = {
        "missions": options.fidelity,
        "budget": options.budget,
        "set": " ".join(options.set),
        "same_proposals_and_outcomes": same,
        **{f"built_in_{key}_per_mission": round(own[key], 2) for key in ("wall_s", "cpu_s")},
        **{f"contract_{key}_per_mission": round(other[key], 2) for key in ("wall_s", "cpu_s")},
    }
    print(row)
    if options.out is not None:
        new = not options.out.exists()
        with options.out.open("a", newline="") as file:
            writer = csv.DictWriter(file, row, lineterminator="\n")
            if new:
                writer.writeheader()
            writer.writerow(row)


if __name__ == "__main__":
    main()
