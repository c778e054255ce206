"""Recommendations of finished runs made anew by the product's present rule; nothing is flown again.

    OMP_NUM_THREADS=1 python benchmarks/optimiser_rescore.py runs/optimiser_comparison_old --out runs/optimiser_comparison

What a peer flies does not depend on our Gaussian process, what is recommended after it does. For every complete run of
a peer that is not yet in ``--out``, the missions are checked against the problem (same values as recorded, to the bit
that JSON keeps; geometric ones are flown again unless ``--out`` has their outcomes), and the checkpoints are written
anew. Runs of our own samplers depend on the code and are left alone.
"""

from __future__ import annotations

import argparse
import json
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

from optimiser_comparison import CHECKPOINTS, OUT, common_recommendation, complete, result_file
from optimiser_problems import make_problem

from tuner.problem.observations import Observation


def rescore(path: Path, out: Path) -> str:
    """One run; returns a line for people.

    Raises
    ------
    SystemExit
        A recorded outcome is not what the problem gives now.
    """
    rows: list[dict[str, Any]] = [json.loads(line) for line in path.read_text().splitlines()]
    head, missions = rows[0], [row for row in rows if row["kind"] == "mission"]
    memo = out / "geometric_missions.sqlite"
    problem = make_problem(head["problem"], head["seed"], memo, head["rocks"], head["budget"])
    history: list[Observation] = []
    lines: list[dict[str, Any]] = [{**head, "rescored": True}]
    marks = [share * problem.budget for share in CHECKPOINTS]
    for mission in missions:
        values, rock, replicate = mission["values"], mission["rock"], mission["replicate"]
        if problem.fly(values, rock, replicate).value != mission["value"]:
            raise SystemExit(f"{path}: mission {len(history)} gives another value now; run it anew")
        history.append(Observation(len(history), values, rock, replicate, mission["value"], mission["value"]))
        lines.append({k: v for k, v in mission.items() if k not in ("mean", "sd")})
        if marks and mission["cost"] >= marks[0] - 1e-6:
            while marks and mission["cost"] >= marks[0] - 1e-6:
                marks.pop(0)
            chosen, mean, sd, _ = common_recommendation(problem, history, head["seed"], None, ours=False)
            belief = {"mean": mean, "sd": sd, "truth": problem.truth(chosen)}
            lines.append({"kind": "checkpoint", "cost": mission["cost"], "values": dict(chosen), **belief})
    lines.append(rows[-1])
    out.mkdir(parents=True, exist_ok=True)
    target = result_file(out, head["problem"], head["strategy"], head["seed"])
    target.write_text("".join(json.dumps(line) + "\n" for line in lines))
    return f"{head['problem']:18s} {head['strategy']:12s} {head['seed']:3d}  {lines[-2].get('truth', float('nan')):8.3f}"


def main() -> None:
    """Parse and go through the folder."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("source", type=Path)
    parser.add_argument("--out", type=Path, default=OUT)
    parser.add_argument("--jobs", type=int, default=1)
    arguments = parser.parse_args()
    paths = []
    for path in sorted(arguments.source.glob("*.jsonl")):
        if not complete(path):
            continue
        head = json.loads(path.read_text().split("\n", 1)[0])
        ours = head["strategy"].startswith("gp")
        done = complete(result_file(arguments.out, head["problem"], head["strategy"], head["seed"]))
        if not (ours or done):
            paths.append(path)
    with ProcessPoolExecutor(arguments.jobs) as pool:
        for line in pool.map(rescore, paths, [arguments.out] * len(paths)):
            print(line, flush=True)


if __name__ == "__main__":
    main()
