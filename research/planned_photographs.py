"""The planner with photographs against orbits of as many, target by target, in `indoors`.

    python -m research.planned_photographs planned_photographs.csv --targets part-20000 animal-20000 --photographs 24

Every mission's scores become a row of the file, which is read first: missions that it holds are not flown again. Then
the table is printed, over targets and replicates that both plans have.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from nbv.config import MissionConfig, load_condition, preset, under
from nbv.photogrammetric import run_photogrammetric_mission
from research import read_rows, write_rows
from research.adaptive_plans import BASE
from tuner.problem.baselines import TWO_RINGS
from tuner.problem.intervals import mean_interval
from tuner.report.labels import difference_text

SEEDS = 12
CONTROL, HYB_H = "orbit at 15°", "Hyb-H, 12 seeds on the paper's rings"
FILLED = ", rings filled"  # of a plan whose candidates include the views between its seeds
Rows = dict[tuple[str, str, int, int], dict[str, Any]]  # by plan, target, photographs, replicate
HEAD = ("plan", "target", "photographs", "replicate", "f_score", "registered", "seeds", "all")


def plans(photographs: int) -> dict[str, dict[str, Any]]:
    """What differs from `BASE`, by plan."""

    def planned(seeds: int, kind: str) -> dict[str, Any]:
        return {"photographs": photographs, "seeds": seeds, "gate.kind": kind}

    def orbit(elevation_deg: float) -> dict[str, Any]:
        return {"photographs": photographs, "seeds": photographs, "seed.lowest_deg": elevation_deg}

    def from_paper_rings(seeds: int, **values: Any) -> dict[str, Any]:
        return {**planned(seeds, "hyb-h"), "seed.layout": "rings", "seed.radius_m": 4.0, **values}

    tuned = {
        "gate.geometry_scorer": "predicted",
        **{f"predicted.weights.{term}": 0.01 for term in ("nov", "move", "ang")},
    }
    return {
        CONTROL: orbit(15.0),
        "orbit at 10°": orbit(10.0),
        "orbit at 20°": orbit(20.0),
        "two rings at 10° and 35°": {**orbit(10.0), **TWO_RINGS},
        HYB_H: from_paper_rings(SEEDS),
        "tuned gate: the same seeds, by *predicted*": from_paper_rings(SEEDS, **tuned),
        "the same seeds and pool, at random": from_paper_rings(SEEDS, **tuned, **{"gate.kind": "random"}),
        "10 seeds on the paper's rings, by *predicted*": from_paper_rings(10, **tuned),
        "12 on a ring at 10°, by *predicted*": planned(SEEDS, "predicted"),
        "all but 4 on a ring at 10°, by *predicted*": planned(photographs - 4, "predicted"),
        "all but 4 on a ring at 10°, at random": planned(photographs - 4, "random"),
    }


def flown(config: MissionConfig, target: str, replicate: int) -> dict[str, Any]:
    """F-score at 48 mm of the observable surface (0 for a failed mission), numbers of photographs, and what the mission expected."""
    result = run_photogrammetric_mission(config, target, replicate)
    metrics: Mapping[str, Any] = result.metrics or {}
    score = metrics.get("observable", {}).get("f_score_48mm", 0.0)
    expected = {name: f"{share:.3f}" for name, share in metrics.get("expected_share", {}).items()}
    images, registered = (int(result.costs[name]) for name in ("images", "registered_images"))
    return {"f_score": f"{score:.3f}", "images": images, "registered": registered, **expected}


def read(path: Path) -> Rows:
    rows = read_rows(path)
    return {(r["plan"], r["target"], int(r["photographs"]), int(r["replicate"])): r for r in rows}


def table(rows: Rows) -> list[str]:
    """A line for each plan: mean F-score and difference to the control by number of photographs, and over all to Hyb-H, too.

    Differences are paired, with 95 % intervals by Student's t over targets; of the first the lowest target stands beside.
    """
    numbers: list[int | None] = [*sorted({number for *_, number, _ in rows})]

    def scores(plan: str, number: int | None) -> dict[tuple[str, int], float]:
        return {
            (target, replicate): float(row["f_score"])
            for (name, target, n, replicate), row in rows.items()
            if name == plan and number in (None, n)
        }

    def by_target(values: Mapping[tuple[str, int], float]) -> dict[str, list[float]]:
        groups: dict[str, list[float]] = {}
        for (target, _), value in values.items():
            groups.setdefault(target, []).append(value)
        return groups

    def gain(plan: str, than: str, number: int | None) -> tuple[str, str]:
        one, other = scores(plan, number), scores(than, number)
        groups = by_target({key: one[key] - other[key] for key in one if key in other})
        lowest = min((float(np.mean(group)) for group in groups.values()), default=0.0)
        return (
            ("–", "–")
            if plan == than
            else (difference_text(mean_interval(groups)), f"{lowest:+.1f}".replace("-", "−"))
        )

    heads = [f"{n} photographs|minus the {CONTROL}|lowest" for n in numbers]
    lines = ["|".join(["", "plan", *heads, f"all, minus the {CONTROL}", "all, minus Hyb-H", ""])]
    lines.append("|---|" + "---:|" * (3 * len(numbers) + 2))
    for plan in dict.fromkeys(name for name, *_ in rows):
        cells = [plan]
        for number in numbers:
            mean = mean_interval(by_target(scores(plan, number)))
            cells += ["–" if mean is None else f"{mean.mean:.1f}", *gain(plan, CONTROL, number)]
        cells += [gain(plan, CONTROL, None)[0], gain(plan, HYB_H, None)[0]]
        lines.append("|".join(["", *cells, ""]))
    return lines


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("file", type=Path)
    parser.add_argument("--targets", nargs="*", default=[])
    parser.add_argument("--photographs", type=int, default=24)
    parser.add_argument("--replicates", type=int, default=1)
    parser.add_argument("--plans", nargs="*", help="by default all")
    parser.add_argument(
        "--fill-rings", action="store_true", help="all planners choose among what *predicted* may"
    )
    asked = parser.parse_args(arguments)
    if asked.fill_rings:
        MissionConfig.fills_rings = property(lambda self: True)  # type: ignore[method-assign,assignment]
    rows, number = read(asked.file), asked.photographs
    base = under(preset("campaign").with_values(BASE), load_condition("indoors"))
    for replicate in range(asked.replicates):
        for target in asked.targets:
            for plan, values in plans(number).items():
                key = f"{plan}{FILLED if asked.fill_rings else ''}", target, number, replicate
                if key in rows or (asked.plans and plan not in asked.plans):
                    continue
                given = dict(zip(HEAD, key))
                rows[key] = {**given, **flown(base.with_values(values), target, replicate)}
                print(rows[key], flush=True)
                write_rows(asked.file, HEAD, rows.values())
    print("\n".join(table(rows)))


if __name__ == "__main__":
    main()
