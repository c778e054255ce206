"""Does a third of the photographs do? A plan of 21 or 32 photographs against the paper's 24 + 40 and 24 + 8.

    OMP_NUM_THREADS=1 python -m research.few_photographs --rocks arch fin --out few.csv [--arms paper-64 tuned-21]

Prints each arm's paired differences, t intervals over rocks. One row per mission: preset `campaign` with 3 agreeing views,
F-score and completeness at 16 and 48 mm (observable surface; registered where telemetry errs). Goes on where a file ends.
"""

from __future__ import annotations

import argparse
import csv
from pathlib import Path
from typing import Any

import numpy as np

from nbv.config import MissionConfig, load_condition, preset, under
from nbv.photogrammetric import run_photogrammetric_mission
from tuner.comparison.statistics import mean_interval

THREE_VIEWS = {"dense.agreeing_views": 3}
FEW: dict[str, Any] = {
    "seed.count": 12,
    "seed.rings": 2,
    "seed.lowest_deg": 15.0,
    "seed.span_deg": 15.0,
    "sparse.ground_features": 2000,
    "sparse.min_registered_seeds": 6,
    "pool.max_altitude_m": 2.1,
    "stop.adaptive_budget": 40,
}
TUNED = {
    "seed.count": 13,
    "seed.rings": 4,
    "seed.span_deg": 21.0,
    "pool.max_altitude_m": 1.541,
    "stop.max_photographs": 21,
}
ARMS: dict[str, dict[str, Any]] = {
    "paper-64": {"stop.adaptive_budget": 40},
    "hyb-h-32": {},
    "few-21-of-16": {**FEW, "seed.count": 16, "stop.max_photographs": 21},
    # What a campaign of 48 missions found on the rocks of `make tune`: the fewest photographs for F-score 98 at 48 mm.
    "tuned-21": {**FEW, **TUNED},
    "tuned-21-random": {**FEW, **TUNED, "gate.kind": "random"},
    # What 21 can be worth: the gate sees the true surface, first in that pool, then with more of them in the paper's.
    "oracle-21": {**FEW, **TUNED, "gate.kind": "greedy-oracle"},
    "oracle-21-of-8": {
        **FEW,
        "seed.count": 8,
        "stop.max_photographs": 21,
        "gate.kind": "greedy-oracle",
        "pool.max_altitude_m": 20.0,
    },
    "few-32": {**FEW, "seed.count": 16, "stop.max_photographs": 32},
    "few-32-random": {**FEW, "seed.count": 16, "stop.max_photographs": 32, "gate.kind": "random"},
}
METRICS = ("f_score_16mm", "f_score_48mm", "completeness_16mm", "completeness_48mm")
HEAD = (
    "condition",
    "rock",
    "replicate",
    "arm",
    "status",
    "reason",
    "photographs",
    "registered",
    "flight (s)",
    *METRICS,
)


def configuration(arm: str, condition: str) -> MissionConfig:
    """The arm's mission under a condition."""
    return under(preset("campaign"), load_condition(condition)).with_values({**THREE_VIEWS, **ARMS[arm]})


PAIRS = (
    ("few-21-of-16", "paper-64"),
    ("tuned-21", "paper-64"),
    ("tuned-21", "hyb-h-32"),
    ("tuned-21", "tuned-21-random"),
    ("oracle-21", "paper-64"),
    ("oracle-21-of-8", "paper-64"),
    ("few-32", "paper-64"),
    ("few-32", "hyb-h-32"),
    ("few-32", "few-32-random"),
)


def tell(out: Path) -> None:
    """Each arm's means, and paired differences over common rocks and replicates with 95 % intervals over rocks."""
    with out.open(newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["f_score_48mm"]]
    for condition in dict.fromkeys(row["condition"] for row in rows):
        of = {(r["rock"], r["replicate"], r["arm"]): r for r in rows if r["condition"] == condition}
        arms = dict.fromkeys(arm for _, _, arm in of)
        for arm in arms:
            own = [row for (*_, a), row in of.items() if a == arm]
            columns = ("photographs", "flight (s)", *METRICS)
            shown = " ".join(f"{np.mean([float(row[c]) for row in own]):.2f}" for c in columns)
            print(f"{condition} {arm}, {len(own)} missions: {shown}")
        for one, other in PAIRS:
            places = [(rock, k) for rock, k, arm in of if arm == one and (rock, k, other) in of]
            for metric in METRICS:
                gains: dict[str, list[float]] = {}
                for rock, k in places:
                    gain = float(of[rock, k, one][metric]) - float(of[rock, k, other][metric])
                    gains.setdefault(rock, []).append(gain)
                if len(gains) < 2 or (found := mean_interval(gains, 2)) is None:
                    continue
                print(
                    f"  {one} - {other}, {metric}: {found.mean:+.2f} [{found.low:+.2f}, {found.high:+.2f}], "
                    f"{len(places)} pairs"
                )


def main() -> None:
    """Run what is not in the file yet, then tell."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--rocks", nargs="+", required=True)
    parser.add_argument("--conditions", nargs="+", default=["ideal", "field"])
    parser.add_argument("--arms", nargs="+", default=[*ARMS], choices=[*ARMS])
    parser.add_argument("--replicate", type=int, default=0)
    parser.add_argument("--out", type=Path, required=True)
    arguments = parser.parse_args()
    done = set()
    if arguments.out.exists():
        with arguments.out.open(newline="") as file:
            done = {(r["condition"], r["rock"], int(r["replicate"]), r["arm"]) for r in csv.DictReader(file)}
    with arguments.out.open("a", newline="") as file:
        rows = csv.writer(file, lineterminator="\n")
        if not done:
            rows.writerow(HEAD)
        for condition in arguments.conditions:
            for rock in arguments.rocks:
                for arm in arguments.arms:
                    key = (condition, rock, arguments.replicate, arm)
                    if key in done:
                        continue
                    result = run_photogrammetric_mission(
                        configuration(arm, condition), rock, arguments.replicate
                    )
                    costs, found = (
                        result.costs,
                        result.metrics.get("registered", result.metrics).get("observable", {}),
                    )
                    evaluated = (costs["images"], costs["registered_images"], costs["flight_time_s"])
                    scores = [f"{found[name]:.2f}" if name in found else "" for name in METRICS]
                    rows.writerow(
                        [*key, result.status, result.reason, *(round(x) for x in evaluated), *scores]
                    )
                    file.flush()
    tell(arguments.out)


if __name__ == "__main__":
    main()
