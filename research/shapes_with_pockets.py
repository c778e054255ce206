"""*predicted*, the greedy oracle and plain plans, on held-out shapes and rocks.

    OMP_NUM_THREADS=1 python -m research.shapes_with_pockets                                  # geometric, 20 and 24 photographs
    OMP_NUM_THREADS=1 python -m research.shapes_with_pockets --photographs machine-20000 ...  # `indoors`, 24 photographs

The best plain plan is the best on average, in hindsight, of three orbits and random views. A target without a model scores 0.
"""

from __future__ import annotations

import argparse
import csv
import sys
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from nbv.config import MissionConfig, load_conditions, under
from nbv.geometric.curve_fidelity import run_curve_mission
from nbv.photogrammetric import run_photogrammetric_mission
from nbv.rocks.families import FAMILIES, HELD_OUT_FROM, SHAPES
from tuner.comparison.curves import Suite, comparison_plans
from tuner.problem.instances import Instance
from tuner.problem.intervals import mean_interval
from tuner.report.labels import difference_text

PLAIN = ("orbit", "orbit-high", "orbit-two", "random")
NUMBERS, SHAPES_EACH, ROCKS_EACH = (20, 24), 6, 3
Scores = dict[str, dict[str, dict[int, float]]]  # F-score at 48 mm by strategy, target, photographs


def by_curve(config: MissionConfig, target: str) -> dict[int, float]:
    """A geometric mission, read at every number."""
    curve = (run_curve_mission(config, target, 0).metrics or {}).get("curve") or []
    return {int(number): score for number, score, _ in curve}


def by_photographs(config: MissionConfig, target: str) -> dict[int, float]:
    """A mission with photographs in a dim hall."""
    result = run_photogrammetric_mission(under(config, load_conditions(["indoors"])[0]), target, 0)
    return {NUMBERS[-1]: (result.metrics or {}).get("observable", {}).get("f_score_48mm", 0.0)}


def scores_of(
    targets: Sequence[str], numbers: Sequence[int], run: Callable[..., dict[int, float]], fidelity: str
) -> Scores:
    """Every strategy on every target."""
    suite, found = Suite(tuple(map(Instance, targets)), tuple(numbers), fidelity=fidelity), Scores()
    (plan,) = comparison_plans(suite, dict.fromkeys(("predicted", "greedy-oracle", *PLAIN))).values()
    for target in targets:
        for name, config in plan.strategies.items():
            strategy = next(
                s
                for s in ("predicted", "greedy-oracle", *reversed(PLAIN))
                if name in (s, *(f"{s}-{n}" for n in numbers))
            )
            found.setdefault(strategy, {}).setdefault(target, {}).update(run(config, target))
            print(f"{target}: {name} {found[strategy][target]}", file=sys.stderr, flush=True)
    return found


def row(title: str, found: Scores, targets: Sequence[str], number: int) -> str:
    """A line of the table."""
    scores: Mapping[str, list[float]] = {
        s: [own[t].get(number, 0.0) for t in targets] for s, own in found.items()
    }
    best = max(PLAIN, key=lambda name: np.mean(scores[name]))

    def gain(name: str) -> str:
        pairs = zip(targets, scores[name], scores[best])
        return difference_text(mean_interval({t: [a - b] for t, a, b in pairs}), 2)

    cells = f"{np.mean(scores[best]):.2f} (`{best}`)", gain("predicted"), gain("greedy-oracle")
    return f"|{title}, {number} photographs|{len(targets)}|{'|'.join(cells)}|"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--photographs", nargs="*", help="These targets, with photographs.")
    asked = parser.parse_args()
    print("|targets|number|best plain plan|*predicted*|greedy oracle|\n|---|---:|---:|---:|---:|")
    if asked.photographs:
        found = scores_of(asked.photographs, NUMBERS[-1:], by_photographs, "photogrammetric")
        print(row("shapes", found, asked.photographs, NUMBERS[-1]))
    else:
        each = dict.fromkeys(SHAPES, SHAPES_EACH) | dict.fromkeys(FAMILIES, ROCKS_EACH)
        groups = {f: [f"{f}-{HELD_OUT_FROM + k}" for k in range(count)] for f, count in each.items()}
        found = scores_of([t for own in groups.values() for t in own], NUMBERS, by_curve, "curve")
        every = {"shapes": [t for f in SHAPES for t in groups[f]], **{f: groups[f] for f in SHAPES}}
        every["rocks"] = [t for f in FAMILIES for t in groups[f]]
        for number in reversed(NUMBERS):
            print("\n".join(row(title, found, own, number) for title, own in every.items()))
    csv.writer(sys.stderr).writerows(
        (s, t, n, f) for s, own in found.items() for t, at in own.items() for n, f in at.items()
    )


if __name__ == "__main__":
    main()
