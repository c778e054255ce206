"""The same warm campaign missions with the code of another tree and with this one, in turn: CPU seconds of each.

    git worktree add --detach OLD COMMIT
    python -m research.old_and_new --old OLD --condition field --out pairs.csv

Each tree has its own rocks and store under ``--home``. A first flight fills the store; then what it keeps of whole
missions is forgotten before each flight, so that photographs, features, pairs and seed models are known and mapping,
dense stage and metrics are not. CPU: user and system seconds of the mission's process and its children, imports left out.
Goes on where a file ends.
"""

from __future__ import annotations

import argparse
import csv
import json
import os
import statistics
import subprocess
import sys
from pathlib import Path
from typing import Any

from research.fresh_process import forget_sequences

HERE = Path(__file__).resolve().parent.parent
# Runs under trees whose rooms have other names: nothing of this tree may be imported.
FLY = """
import json, os, resource, sys, time
rock, replicate, condition = sys.argv[1], int(sys.argv[2]), sys.argv[3]
from nbv.threads import single_thread_environment
single_thread_environment()
import cv2, open3d, pycolmap, scipy.spatial
try:
    from nbv.photogrammetric import run_photogrammetric_mission as fly
    from nbv.config import load_condition, preset, under
    config = under(preset("campaign"), load_condition(condition))
except ImportError:  # before there were conditions
    from nbv.mission import run_mission as fly
    from nbv.config import preset
    assert condition == "ideal"
    config = preset("campaign")
time.perf_counter = time.process_time
before = sum(os.times()[:4])
result = fly(config, rock, replicate)
cpu_s = sum(os.times()[:4]) - before
peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
surfaces = {"": result.metrics, **{k: v for k, v in result.metrics.items() if k == "registered"}}
scores = {f"{name}:{key}": s["observable"][key]
          for name, s in surfaces.items() for key in ("f_score_48mm", "f_score_16mm")}
print(json.dumps({"status": result.status, "cpu_s": cpu_s, "peak_mb": peak_mb, "scores": scores,
                  "seconds": {k: result.timings_s.get(k, 0.0) for k in ("update", "dense", "evaluation")}}))
"""
HEAD = (
    "condition",
    "rock",
    "replicate",
    "round",
    "code",
    "status",
    "cpu_s",
    "update_s",
    "dense_s",
    "evaluation_s",
    "peak_mb",
    "f_score_48mm",
    "f_score_16mm",
    "registered_f_score_48mm",
    "registered_f_score_16mm",
)


def run_missions(tree: Path, home: Path, rock: str, replicate: int, condition: str) -> dict[str, Any]:
    """One mission in a process of its own."""
    environment = {**os.environ, "PYTHONPATH": str(tree), "GATETUNE_HOME": str(home), "OMP_NUM_THREADS": "1"}
    ran = subprocess.run(
        [sys.executable, "-c", FLY, rock, str(replicate), condition],
        cwd=tree,
        env=environment,
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    )
    evaluated: dict[str, Any] = json.loads(ran.stdout.splitlines()[-1])
    return evaluated


def row(evaluated: dict[str, Any]) -> list[Any]:
    """Its numbers in the order of `HEAD`."""
    scores = evaluated["scores"]
    return [
        evaluated["status"],
        round(evaluated["cpu_s"], 2),
        *(round(evaluated["seconds"][stage], 2) for stage in ("update", "dense", "evaluation")),
        round(evaluated["peak_mb"]),
        *(
            scores.get(f"{name}:{key}", "")
            for name in ("", "registered")
            for key in ("f_score_48mm", "f_score_16mm")
        ),
    ]


def summary(rows: list[dict[str, str]]) -> str:
    """Mean CPU seconds of both, and the ratio of new to old with its spread over missions."""
    missions: dict[tuple[str, str], dict[str, list[float]]] = {}
    for r in rows:
        of = missions.setdefault((r["rock"], r["replicate"]), {"old": [], "new": []})
        of[r["code"]].append(float(r["cpu_s"]))
    pairs = [(statistics.mean(m["old"]), statistics.mean(m["new"])) for m in missions.values() if m["new"]]
    ratios = sorted(new / old for old, new in pairs)
    old, new = (statistics.mean(side) for side in zip(*pairs))
    return (
        f"{len(pairs)} missions: CPU s old {old:.2f}, new {new:.2f} ({2 * 3600 / new:.0f} an hour on two cores); "
        f"new / old: median {statistics.median(ratios):.3f}, {ratios[0]:.3f} to {ratios[-1]:.3f}"
    )


def main() -> None:
    """Fly what is not in the file yet."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--old", type=Path, required=True, help="a tree with the other code")
    parser.add_argument("--condition", default="ideal")
    parser.add_argument("--rocks", nargs="+", default=["boulder", "slab", "waist"])
    parser.add_argument("--replicates", type=int, nargs="+", default=[0, 1])
    parser.add_argument("--rounds", type=int, default=1)
    parser.add_argument("--home", type=Path, default=Path("runs/old_and_new"))
    parser.add_argument("--out", type=Path, required=True)
    arguments = parser.parse_args()
    trees = {"old": arguments.old.resolve(), "new": HERE}
    rows: list[dict[str, str]] = []
    if arguments.out.exists():
        with arguments.out.open(newline="") as file:
            rows = list(csv.DictReader(file))
    done = {tuple(r[key] for key in HEAD[:5]) for r in rows}
    with arguments.out.open("a", newline="") as file:
        out = csv.writer(file, lineterminator="\n")
        if not rows:
            out.writerow(HEAD)
        for rock in arguments.rocks:
            for replicate in arguments.replicates:
                mission = (arguments.condition, rock, str(replicate))
                todo = [
                    (turn, code)
                    for turn in range(arguments.rounds)
                    for code in (("old", "new"), ("new", "old"))[(turn + replicate) % 2]
                    if (*mission, str(turn), code) not in done
                ]
                homes = {code: (arguments.home / code).resolve() for code in trees}
                for code in {code for _, code in todo}:
                    filled = homes[code] / ("filled-" + "-".join(mission))
                    if not filled.exists():
                        run_missions(trees[code], homes[code], rock, replicate, arguments.condition)
                        filled.touch()
                for turn, code in todo:
                    forget_sequences(homes[code])
                    forget_sequences(homes[code], "_")  # its kinds were spelt so before 0d2f783
                    evaluated = run_missions(trees[code], homes[code], rock, replicate, arguments.condition)
                    out.writerow([*mission, turn, code, *row(evaluated)])
                    file.flush()
    with arguments.out.open(newline="") as file:
        print(summary(list(csv.DictReader(file))))


if __name__ == "__main__":
    main()
