"""Planned views against orbits, with photographs: known targets, targets to be found, neighbours, and the stop run.

    python -m research.planning_in_conditions fly --condition field --out field.csv --rock boulder-20001 ...
    python -m research.planning_in_conditions tell field.csv
    python -m research.planning_in_conditions stop docs/results/data/stop_with_photographs.csv

The vehicle knows the size of a drawn rock to `TargetConfig.size_error_percent`. Where the condition has a target that must
be found, the position it is told has the condition's error, and it finds the rock in its own photographs: a re-targeted orbit
after its first 12, a planned strategy after its seeds. Scores are registered where telemetry errs; a failed mission scores 0.
``tell`` pairs the strategies rock by rock, with 95 % bootstrap intervals over rocks.
"""

from __future__ import annotations

import argparse
import csv
from pathlib import Path
from typing import Any

import numpy as np

from nbv.config import under
from nbv.config.conditions import Condition, load_condition
from nbv.rocks.families import HELD_OUT_FROM, generated_name
from nbv.scorers.prediction import predict
from nbv.types import Floats
from research.adaptive_plans import FIDELITIES, base, run_missions
from research.where_planning_pays import interval, read

MOST = 48
SEEDS: dict[str, Any] = {"seed.count": 12, "seed.lowest_deg": 10.0, "seed.second_turn": True}
TWO_RINGS: dict[str, Any] = {"seed.upper_share": 0.36, "seed.span_deg": 25.0}
RETARGETED: dict[str, Any] = {"seed.retarget_after": 12}
ORBITS: dict[str, dict[str, Any]] = {
    "one ring": {},
    "two rings": TWO_RINGS,
    "one ring, re-targeted": RETARGETED,
    "two rings, re-targeted": {**TWO_RINGS, **RETARGETED},
}
PLANNED: dict[str, dict[str, Any]] = {
    "adaptive": {"gate.kind": "predicted"},
    "Hyb-H": {"gate.kind": "hyb-h"},
    "random views": {"gate.kind": "random"},
    "greedy oracle": {
        "gate.kind": "greedy-oracle",
        "gate.oracle_coverage": "matchable",
        "gate.oracle_samples": 3000,
    },
    "random views in the tuned pool": {"gate.kind": "random", "pool.max_altitude_m": 1.45},
}
STOPPED = "stopped"
# Run beside those of ``conditions/``.
CONDITIONS = {
    # They hide the larger part of the rock from a third of the lowest ring.
    "neighbours": Condition(
        "neighbours",
        {"ground": {"neighbours": 8, "neighbour_height_m": [1.4, 1.5], "neighbour_gap_m": [0.05, 0.8]}},
    ),
    "known-to-1m": Condition("known-to-1m", {"target": {"horizontal_sd_m": 1.0, "vertical_sd_m": 0.3}}),
}
HEAD = ("rock", "condition", "arm", "photographs", "registered", "f_score", "predicted", "flight_s", "status")


def condition_of(name: str) -> Condition:
    return CONDITIONS.get(name) or load_condition(name)


def arm_values(arm: str, count: int, percent: float) -> dict[str, Any]:
    """What an arm changes: ``count`` photographs in all; the stopped one ends at a predicted ``percent``."""
    if arm in ORBITS:
        return {**ORBITS[arm], "seed.count": count}
    if arm == STOPPED:
        ends = {"stop.criterion": "predicted", "stop.predicted_percent": percent}
        return {**SEEDS, **PLANNED["adaptive"], **ends, "stop.adaptive_budget": MOST - SEEDS["seed.count"]}
    return {**SEEDS, **PLANNED[arm], "stop.adaptive_budget": count - SEEDS["seed.count"]}


def mission(
    rock: str, condition: str, arm: str, count: int, percent: float, fidelity: str = "photogrammetric"
) -> tuple[Any, ...]:
    """A row as `HEAD`.

    Parameters
    ----------
    rock, condition, arm
        Their names.
    count
        Photographs in all, of an arm that does not stop by itself.
    percent
        The prediction at which one does.
    fidelity
        As `research.adaptive_plans.run_missions` has it.
    """
    values = arm_values(arm, count, percent)
    evaluated = run_missions(under(base(**values), condition_of(condition)), rock, fidelity)
    result, costs = evaluated.result, evaluated.result.costs
    score = told = float("nan")
    if result.status == "failed":
        score = 0.0
    else:
        path = "observable.f_score_48mm"
        score = result.metric(f"registered.{path}" if "registered" in result.metrics else path)
    if evaluated.model is not None:
        told = predict(evaluated.model, evaluated.vehicle_config).f_score_percent
    photographs, registered = int(costs["images"]), int(costs["registered_images"])
    row = (photographs, registered, f"{score:.3f}", f"{told:.3f}", f"{costs['flight_time_s']:.1f}")
    return (Path(rock).stem, condition, arm, *row, result.reason or result.status)


def fly_all(arguments: argparse.Namespace) -> None:
    """What the file does not have yet, rock by rock."""
    out: Path = arguments.out
    fresh = not out.exists()
    evaluated = set() if fresh else {(r["rock"], r["condition"], r["arm"]) for r in read(out)}
    with out.open("a", newline="") as file:
        writer = csv.writer(file)
        if fresh:
            writer.writerow(HEAD)
        for rock in arguments.rock:
            for arm in arguments.arms:
                if (Path(rock).stem, arguments.condition, arm) not in evaluated:
                    asked = (arguments.count, arguments.percent, arguments.fidelity)
                    writer.writerow(mission(rock, arguments.condition, arm, *asked))
                    file.flush()


def tell(rows: list[dict[str, str]], against: str, score: float) -> list[str]:
    """Every arm alone, then ``against`` less each other one, on the rocks that all arms have."""
    lines = []
    for condition in dict.fromkeys(row["condition"] for row in rows):
        here = [row for row in rows if row["condition"] == condition]
        arms = list(dict.fromkeys(row["arm"] for row in here))
        of = {arm: {row["rock"]: row for row in here if row["arm"] == arm} for arm in arms}
        rocks = sorted(set.intersection(*(set(rocks) for rocks in of.values())))
        values = {arm: np.array([float(of[arm][rock]["f_score"]) for rock in rocks]) for arm in arms}
        lines.append(f"{condition}: {len(rocks)} rocks")
        for arm in arms:
            n = np.array([float(of[arm][rock]["photographs"]) for rock in rocks])
            v = values[arm]
            failed = sum(of[arm][rock]["f_score"] == "0.000" for rock in rocks)
            lines.append(
                f"  {arm}: {n.mean():.1f} photographs, mean {v.mean():.2f}, worst {v.min():.1f}, "
                f"share >= {score:g} {(v >= score).mean():.2f}, failed {failed}"
            )
        for arm in arms:
            if arm != against and against in values:
                share = (values[against] >= score).astype(float) - (values[arm] >= score)
                gain = values[against] - values[arm]
                lines.append(f"  {against} less {arm}: score {interval(gain)}, share {interval(share)}")
    return lines


def tell_stop(rows: list[dict[str, str]], score: float) -> list[str]:
    """Of arms that end by themselves: photographs, the share that reaches ``score``, and the orbit with no smaller a share.

    Ratios have 95 % bootstrap intervals over rocks; where no orbit of a draw has such a share, the most photographs that
    any mission may take stand for it. Of training rocks there is no ratio.
    """
    lines = []
    for split, here in _by_split(rows).items():
        ended = list(dict.fromkeys(row["arm"] for row in here if row["arm"].startswith("ended")))
        orbits = sorted({int(row["photographs"]) for row in here if row["arm"] == "two rings"})
        of = {(row["arm"], row["rock"]): row for row in here if row["arm"] in ended}
        of |= {(row["photographs"], row["rock"]): row for row in here if row["arm"] == "two rings"}
        rocks = sorted({row["rock"] for row in here if row["arm"] == ended[0]})

        def reached(arm: str, of: Any = of, rocks: Any = rocks) -> Floats:
            return np.array([float(of[arm, rock]["f_score"]) >= score for rock in rocks])

        by_orbit = {n: reached(str(n)) for n in orbits}
        lines.append(f"{split}: {len(rocks)} rocks")
        lines += [f"  two rings of {n}: share {of_orbit.mean():.3f}" for n, of_orbit in by_orbit.items()]
        for arm in ended:
            taken = np.array([float(of[arm, rock]["photographs"]) for rock in rocks])
            told = f"  {arm}: {taken.mean():.1f} photographs, share {reached(arm).mean():.3f}"
            if split == "held-out":
                told += f", of an orbit's {_ratio(taken, reached(arm), by_orbit)}"
            lines.append(told)
    return lines


def _ratio(taken: Floats, reached: Floats, by_orbit: dict[int, Floats]) -> str:
    """Photographs (R,) in the mean over those of the smallest orbit that reaches no smaller a share of the R rocks."""

    def of(drawn: Any) -> float:
        share = reached[drawn].mean()
        enough = [n for n, of_orbit in by_orbit.items() if of_orbit[drawn].mean() >= share]
        return float(taken[drawn].mean() / min(enough, default=MOST))

    draws = np.random.default_rng(0).integers(0, len(taken), (4000, len(taken)))
    low, high = np.percentile([of(drawn) for drawn in draws], [2.5, 97.5])
    return f"{of(np.arange(len(taken))):.2f} [{low:.2f}, {high:.2f}]"


def _by_split(rows: list[dict[str, str]]) -> dict[str, list[dict[str, str]]]:
    """Drawn rocks with seeds from `HELD_OUT_FROM` on, and scans, are held out."""
    found: dict[str, list[dict[str, str]]] = {"train": [], "held-out": []}
    for row in rows:
        drawn = generated_name(row["rock"])
        found["train" if drawn is not None and drawn[1] < HELD_OUT_FROM else "held-out"].append(row)
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    commands = parser.add_subparsers(dest="what", required=True)
    running = commands.add_parser("fly")
    running.add_argument("--rock", nargs="+", required=True)
    running.add_argument("--condition", default="ideal")
    running.add_argument("--count", type=int, default=24)
    running.add_argument(
        "--percent", type=float, default=98.0, help="the prediction that ends the stopped arm"
    )
    running.add_argument("--arms", nargs="+", required=True, choices=[*ORBITS, *PLANNED, STOPPED])
    running.add_argument("--fidelity", default="photogrammetric", choices=FIDELITIES)
    running.add_argument("--out", type=Path, required=True)
    telling = commands.add_parser("tell")
    telling.add_argument("file", type=Path)
    telling.add_argument("--against", default="adaptive")
    telling.add_argument("--score", type=float, default=98.0)
    stopping = commands.add_parser("stop")
    stopping.add_argument("file", type=Path)
    stopping.add_argument("--score", type=float, default=98.0)
    arguments = parser.parse_args()
    if arguments.what == "fly":
        fly_all(arguments)
    elif arguments.what == "stop":
        print("\n".join(tell_stop(read(arguments.file), arguments.score)))
    else:
        print("\n".join(tell(read(arguments.file), arguments.against, arguments.score)))


if __name__ == "__main__":
    main()
