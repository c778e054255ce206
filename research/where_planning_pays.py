"""Where does planning pay? What the curves of drawn rocks say at an equal share of rocks and at an equal number.

    python -m research.where_planning_pays docs/results/data/where_planning_pays.csv
    python -m research.where_planning_pays docs/results/data/where_planning_pays.csv \\
        --held-out docs/results/data/where_planning_pays_believed.csv
    OMP_NUM_THREADS=1 python -m research.where_planning_pays IN.csv --fly OUT.csv  # IN, the planned missions flown anew

``gatetune compare`` runs the same strategies and writes such curves. It has no training rocks: here the threshold at
which a mission stops, and level and slope of two rings of ``level + slope ln(height / m)`` photographs, are chosen on the
training rocks of the file. The held-out rocks (of another file with ``--held-out``) are then read at the share of rocks that
the stopped mission brings to ``--score``. Intervals are 95 %, by a bootstrap over rocks.
"""

from __future__ import annotations

import argparse
import csv
import functools
import itertools
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from nbv.geometric.curve_fidelity import run_curve_mission
from nbv.mission.result import MissionResult
from nbv.rocks.families import HELD_OUT_FROM
from nbv.types import Floats, Ints
from research.adaptive_plans import base
from research.predict_completeness import PLANS
from tuner.comparison.curves import Series
from tuner.problem.intervals import BOOTSTRAP, bootstrap_means

COUNTS = (16, 18, 20, 22, 24, 26, 28, 30, 32, 34, 36, 38, 40, 44, 48)
NUMBERS = range(12, 49)
OF_THE_ORBIT = 0.9  # a stop or a rule must reach this part of the largest share of any orbit
PLANNED, ONE_RING, TWO_RINGS = "adaptive", "one ring at 10°", "rings at 10° and 35°"
THRESHOLDS_PERCENT = np.arange(92.0, 99.6, 0.25)
SLOPES = np.arange(0.0, 41.0, 5.0)  # photographs more on a rock 2.7 times as high
LEVELS = np.arange(8.0, 48.1, 1.0)  # photographs of a rock 1 m high


def read(path: Path) -> list[dict[str, str]]:
    """Rows of a CSV file."""
    with path.open() as file:
        return list(csv.DictReader(file))


def interval(values: Floats) -> str:
    """Mean and its 95 % bootstrap interval."""
    (found,) = bootstrap_means(values)
    return f"{found.mean:+.2f} [{found.low:+.2f}, {found.high:+.2f}]"


class Curves:
    """F-scores and predictions after every photograph, of the rocks that all strategies ran on."""

    def __init__(self, rows: Iterable[dict[str, str]]) -> None:
        self._of: dict[tuple[str, str], dict[str, dict[int, float]]] = {}
        heights_m = {}
        for row in rows:
            heights_m[row["rock"]] = float(row["believed_m"])
            values = {n: float(row[str(n)]) for n in NUMBERS if row[str(n)]}
            if row["arm"] not in (ONE_RING, TWO_RINGS):  # a mission without a model has no score
                values = dict.fromkeys(NUMBERS, 0.0) | values
            self._of.setdefault((row["value"], row["arm"]), {})[row["rock"]] = values
        self.rocks = sorted(
            set.intersection(*(set(self.f_scores(a)) for a in (PLANNED, ONE_RING, TWO_RINGS)))
        )
        self.heights_m = np.array([heights_m[rock] for rock in self.rocks])

    def f_scores(self, arm: str) -> dict[str, dict[int, float]]:
        """By rock and number of photographs; no rocks of a strategy that never ran."""
        return self._of.get(("f_score", arm), {})

    def at(self, arm: str, count: int) -> Floats:
        """(R,) F-scores with ``count`` photographs."""
        return np.array([self.f_scores(arm)[rock][count] for rock in self.rocks])

    def one_number(self, arm: str) -> Series:
        """The same number on every rock, `COUNTS` in turn."""
        count = np.repeat(np.array(COUNTS, dtype=float)[:, None], len(self.rocks), 1)
        return Series(arm, count, np.array([self.at(arm, n) for n in COUNTS]))

    def stopped(self, thresholds_percent: Iterable[float]) -> Series:
        """The planned mission where its prediction first reaches a threshold; at its end where it never does."""
        ends: list[list[tuple[int, float]]] = []
        for threshold in thresholds_percent:
            ends.append([])
            for rock in self.rocks:
                steps, told = self.f_scores(PLANNED)[rock], self._of["predicted", PLANNED][rock]
                n = next((n for n in NUMBERS if told[n] >= threshold), NUMBERS[-1])
                ends[-1].append((n, steps[n]))
        found = np.array(ends, dtype=float)
        return Series(PLANNED, found[..., 0], found[..., 1])

    def by_height(self, slope: float) -> Series:
        """Two rings whose number follows the height that the vehicle was told, `LEVELS` in turn."""
        counts, rings = np.array(COUNTS), self.one_number(TWO_RINGS)
        wanted = LEVELS[:, None] + slope * np.log(self.heights_m)
        at = np.minimum(np.searchsorted(counts, wanted), len(counts) - 1)
        return Series("by height", counts[at].astype(float), rings.scores[at, np.arange(len(self.rocks))])

    def fixed(self, share: float, score: float, of: Ints) -> tuple[float, str]:
        """The orbit with the fewest photographs for ``share`` of the rocks ``of``; else the largest."""
        orbits = [self.one_number(arm) for arm in (ONE_RING, TWO_RINGS)]
        return min((needed(one, share, score, of), one.name) for one in orbits)

    def chosen(self, candidates: Series, score: float) -> int:
        """The setting with the fewest photographs for those of the orbit with the same share; chosen on training rocks."""
        everyone = np.arange(len(self.rocks))
        most = max((self.one_number(a).scores >= score).mean(axis=1).max() for a in (ONE_RING, TWO_RINGS))
        shares = (candidates.scores >= score).mean(axis=1)
        ratios = [
            mean / self.fixed(share, score, everyone)[0] if share >= OF_THE_ORBIT * most else np.inf
            for mean, share in zip(candidates.mean_photographs(everyone), shares, strict=True)
        ]
        return int(np.argmin(ratios))


def flown(row: dict[str, str]) -> dict[str, str]:
    """A row of the planned mission, flown anew: its F-scores, or what it predicted of them."""
    result = _planned(row["rock"])
    column = 1 if row["value"] == "f_score" else 2
    curve = {str(step[0]): f"{step[column]:.3f}" for step in (result.metrics or {}).get("curve") or []}
    return {**row, **{str(n): curve.get(str(n), "") for n in NUMBERS}}


@functools.lru_cache(maxsize=1)
def _planned(rock: str) -> MissionResult:
    return run_curve_mission(base(**PLANS[PLANNED]), rock, 0)


def needed(series: Series, share: float, score: float, of: Ints) -> float:
    """`Series.needed`; the photographs of its last setting where no setting is enough."""
    found = series.needed(share, score, of)
    return float(series.mean_photographs(of)[-1]) if found is None else found


def at_equal_share(test: Curves, stop: Series, slope: float, score: float, of: Ints) -> str:
    """One setting of a stop or rule, on the rocks ``of``, against both controls at the share that it reaches."""
    count, reached, by_height = stop.photographs[0], stop.scores[0] >= score, test.by_height(slope)
    orbits = [test.one_number(arm) for arm in (ONE_RING, TWO_RINGS)]

    def ratios(of: Ints) -> tuple[float, float]:
        share, mean = float(reached[of].mean()), float(count[of].mean())
        return mean / needed(by_height, share, score, of), mean / min(
            needed(one, share, score, of) for one in orbits
        )

    rng = np.random.default_rng(0)
    draws = [ratios(of[rng.integers(0, len(of), len(of))]) for _ in range(BOOTSTRAP)]
    low, high = np.percentile(draws, [2.5, 97.5], axis=0)
    of_height, of_fixed = ratios(of)
    share, mean = reached[of].mean(), count[of].mean()
    fixed, arm = test.fixed(share, score, of)
    return (
        f"{len(of)} rocks, share {share:.3f}: {stop.name} {mean:.1f}; by height {mean / of_height:.1f}, "
        f"{of_height:.2f} [{low[0]:.2f}, {high[0]:.2f}]; {arm} {fixed:.0f}, {of_fixed:.2f} [{low[1]:.2f}, {high[1]:.2f}]"
    )


def tell(train: Curves, test: Curves, score: float) -> list[str]:
    """The comparison at equal share, then at equal number, as lines."""
    everyone, family = np.arange(len(test.rocks)), np.array([r.rpartition("-")[0] for r in test.rocks])
    threshold = THRESHOLDS_PERCENT[train.chosen(train.stopped(THRESHOLDS_PERCENT), score)]
    rules = [train.by_height(slope) for slope in SLOPES]
    every_rule = Series("", *(np.concatenate([vars(r)[k] for r in rules]) for k in ("photographs", "scores")))
    which, level = divmod(train.chosen(every_rule, score), len(LEVELS))
    slope, stop = float(SLOPES[which]), test.stopped([threshold])
    of_rule = test.by_height(slope)
    rule = Series("rule", of_rule.photographs[[level]], of_rule.scores[[level]])
    lines = [
        f"{len(train.rocks)} train rocks: stop at a predicted {threshold:g} %",
        f"all: {at_equal_share(test, stop, slope, score, everyone)}",
        f"rule of the train rocks: two rings of {LEVELS[level]:g} + {slope:g} ln(believed height / m)",
        f"all: {at_equal_share(test, rule, slope, score, everyone)}",
    ]
    for name in sorted(set(family)):
        lines.append(f"{name}: {at_equal_share(test, stop, slope, score, np.flatnonzero(family == name))}")
    share = max((test.one_number(arm).scores >= score).mean(axis=1).max() for arm in (ONE_RING, TWO_RINGS))
    own, (fixed, _) = (
        needed(test.one_number(PLANNED), share, score, everyone),
        test.fixed(share, score, everyone),
    )
    lines.append(f"one number for all rocks, share {share:.2f}: {PLANNED} {own:.0f}, fixed {fixed:.0f}")
    for n in (16, 20, 24, 28, 32, 40):
        best = max((ONE_RING, TWO_RINGS), key=lambda arm: train.at(arm, n).mean())
        mine, its = test.at(PLANNED, n), test.at(best, n)
        lines.append(
            f"{n} photographs: {PLANNED} {mine.mean():.2f}, {best} {its.mean():.2f}, gain {interval(mine - its)},"
            f" share {(mine >= score).mean():.2f} against {(its >= score).mean():.2f}"
        )
    random = test.f_scores("random views")
    for n in (20, 24, 40) if random else ():
        gain = np.array([test.f_scores(PLANNED)[rock][n] - scores[n] for rock, scores in random.items()])
        lines.append(f"{n} photographs: {PLANNED} less random views {interval(gain)}, {len(random)} rocks")
    arms = {arm: test.f_scores(arm) for arm in (PLANNED, ONE_RING, TWO_RINGS, "random views")}
    never = [
        r for r in test.rocks if max(f for of in arms.values() for f in of.get(r, {0: 0.0}).values()) < score
    ]
    return [*lines, f"never at {score:g} with any plan: {', '.join(never)}"]


def main() -> None:
    """Print the comparison."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("file", type=Path, help="curves of training and held-out rocks")
    parser.add_argument("--held-out", type=Path, help="file whose held-out rocks are read instead")
    parser.add_argument("--score", type=float, default=98.0)
    parser.add_argument("--fly", type=Path, help="fly the planned missions of FILE anew, and write this file")
    given = parser.parse_args()
    if given.fly:
        rows = read(given.file)
        with given.fly.open("w", newline="") as file:
            writer = csv.DictWriter(file, rows[0])
            writer.writeheader()
            for row in rows:
                writer.writerow(flown(row) if row["arm"] == PLANNED else row)
        return

    def split(path: Path, held_out: bool) -> Curves:
        rows: list[dict[str, Any]] = read(path)
        return Curves(
            itertools.compress(
                rows, [(int(row["rock"].rpartition("-")[2]) >= HELD_OUT_FROM) == held_out for row in rows]
            )
        )

    print("\n".join(tell(split(given.file, False), split(given.held_out or given.file, True), given.score)))


if __name__ == "__main__":
    main()
