"""Where does planning pay? F-score against photographs, rock by rock: plain orbits, the adaptive plan, random views, an oracle.

    python -m research.where_planning_pays curves --split train --rocks 10 --out curves.csv
    python -m research.where_planning_pays curves --split held-out --rocks 34 --out curves.csv
    python -m research.where_planning_pays tell curves.csv
    python -m research.where_planning_pays bounds --rock cleft-20000 breccia-20002

``curves`` flies geometric missions: an orbit for each number of photographs, and each planned arm once, to the end, with the
score and the prediction after every photograph, so that any threshold of the stop can be told afterwards. The vehicle is
told the height of each rock with an error (``target.size_error_percent``), and so is the control that goes by it: two rings of
``level + slope ln(height / m)`` photographs. ``tell`` chooses the threshold, and level and slope, on the training rocks of the
file and reports on the held-out ones: mean photographs at an equal share of rocks that reach ``--score``, with 95 % bootstrap
intervals over rocks. ``--rocks`` counts seeds of each family. ``bounds`` says what keeps a rock from it.
"""

from __future__ import annotations

import argparse
import csv
import functools
import itertools
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from nbv.cache import Store
from nbv.config import MissionConfig
from nbv.flight.arrival import arrival_position
from nbv.geometric.completeness import predicted_metrics, sample_probability
from nbv.geometric.world import world_of
from nbv.mission.target_prior import with_size_error, with_true_target
from nbv.rocks import load_coarse_rock
from nbv.rocks.families import HELD_OUT_FROM
from nbv.scorers.prediction import predict
from nbv.types import Bools, Floats, Ints, SparseModel, Viewpoint
from nbv.viewpoints import raw_candidates, seed_viewpoints
from research.adaptive_plans import base, rocks_of, run_missions

MOST = 48
COUNTS = (16, 18, 20, 22, 24, 26, 28, 30, 32, 34, 36, 38, 40, 44, 48)
MANY = (48, 64, 96)
BOUNDS = ("rock", *(f"rings of {n}" for n in MANY), "every place", "greedy oracle")
NUMBERS = range(12, MOST + 1)
HEAD = ("rock", "believed_m", "arm", "value", *NUMBERS)
BOOTSTRAP = 1000
OF_THE_ORBIT = 0.9
TWO_RINGS = "rings at 10° and 35°"
SLOPES = np.arange(0.0, 41.0, 5.0)  # photographs more on a rock 2.7 times as high
LEVELS = np.arange(8.0, 48.1, 1.0)  # photographs of a rock 1 m high
FIXED: dict[str, dict[str, Any]] = {
    "one ring at 10°": {},
    TWO_RINGS: {"seed.upper_share": 0.36, "seed.span_deg": 25.0},
}
ORACLE = {
    "gate.kind": "greedy-oracle",
    "gate.oracle_coverage": "matchable",
    "gate.oracle_samples": 3000,
}
PLANNED: dict[str, dict[str, Any]] = {
    "adaptive": {"gate.kind": "predicted"},
    "random views": {"gate.kind": "random"},
    "greedy oracle": ORACLE,
}
SEEDS: dict[str, Any] = {"seed.count": 12, "seed.lowest_deg": 10.0, "seed.second_turn": True}


def after_every_photograph(config: MissionConfig, rock: str) -> Iterator[tuple[int, float, float]]:
    """Photographs flown, F-score at 48 mm and its prediction (percent), from the seeds to the last view."""
    steps: list[tuple[float, float]] = []

    def look(reconstructor: Any, model: SparseModel, believed: MissionConfig) -> None:
        scores = predicted_metrics(reconstructor._world, reconstructor.predicted(), believed)
        percent = predict(model.points_m, model.camera_centers_m, believed).f_score_percent
        steps.append((scores["observable"]["f_score_48mm"], percent))

    evaluated = run_missions(config, rock, listen=look).result
    first = int(evaluated.costs["images"]) - len(steps) + 1  # seeds that make no model are flown twice
    return ((first + k, *step) for k, step in enumerate(steps))


def of_views(rock_name: str, config: MissionConfig, views: list[Viewpoint]) -> float:
    """F-score at 48 mm of views that are all registered: as a geometric mission has it, without its sparse model."""
    rock = load_coarse_rock(rock_name, Store())
    truth = with_true_target(base(), rock)
    instance = world_of(rock, truth, Store())
    seen = np.array([instance.samples_seen(view.position_m, config.target_m) for view in views])
    centers_m = np.array([arrival_position(view, config.flight, (rock.sha256, 0)) for view in views])
    chance = sample_probability(instance, seen, centers_m, truth)
    return float(predicted_metrics(instance, chance, truth)["observable"]["f_score_48mm"])


def believed(rock: str, **values: Any) -> MissionConfig:
    """What a vehicle is told of a rock."""
    return with_size_error(base(**values), load_coarse_rock(rock, Store()), 0)


def curves(rock: str, arms: list[str], seeds: dict[str, Any]) -> list[tuple[Any, ...]]:
    """Rows as `HEAD` for one rock: by arm its ``f_score``, and of a planned arm what was ``predicted``."""
    rows: list[tuple[Any, ...]] = []
    height_m = f"{2 * believed(rock).target_m[2]:.3f}"

    def add(arm: str, value: str, of: dict[int, float]) -> None:
        rows.append((rock, height_m, arm, value, *(f"{of[n]:.3f}" if n in of else "" for n in NUMBERS)))

    for arm in arms:
        if arm in FIXED:
            configs = [believed(rock, **{**FIXED[arm], "seed.count": count}) for count in COUNTS]
            add(arm, "f_score", {c.seed.total: of_views(rock, c, seed_viewpoints(c)) for c in configs})
            continue
        budget = MOST - seeds["seed.count"]
        config = base(**{**seeds, **PLANNED[arm], "stop.adaptive_budget": budget})
        steps = list(after_every_photograph(config, rock))
        add(arm, "f_score", {n: score for n, score, _ in steps})
        add(arm, "predicted", {n: percent for n, _, percent in steps})
    return rows


def bounds(rock: str) -> tuple[Any, ...]:
    """A row as `BOUNDS`: what more photographs, a planner that sees the surface, and every place together bring a rock."""
    row: list[str] = []
    for count in MANY:
        config = believed(rock, **{**FIXED[TWO_RINGS], "seed.count": count})
        row.append(f"{of_views(rock, config, seed_viewpoints(config)):.2f}")
    row.append(f"{of_views(rock, config, [*seed_viewpoints(config), *raw_candidates(config)]):.2f}")
    config = base(**{**SEEDS, **ORACLE, "stop.adaptive_budget": MOST - SEEDS["seed.count"]})
    row.append(f"{max(score for _, score, _ in after_every_photograph(config, rock)):.2f}")
    return (rock, *row)


ByArm = dict[str, dict[str, dict[int, float]]]  # by arm, rock and number of photographs


class Curves:
    """F-score and prediction after every photograph, by arm and rock."""

    def __init__(self, rows: Iterable[dict[str, str]]) -> None:
        kinds: dict[str, ByArm] = {"f_score": {}, "predicted": {}}
        self.believed_m: dict[str, float] = {}
        for row in rows:
            self.believed_m[row["rock"]] = float(row["believed_m"])
            values = {n: float(row[str(n)]) for n in NUMBERS if row[str(n)]}
            if row["arm"] not in FIXED:  # without a model there is nothing
                values = dict.fromkeys(NUMBERS, 0.0) | values
            kinds[row["value"]].setdefault(row["arm"], {})[row["rock"]] = values
        every, self.told = kinds.values()
        most = max(len(rocks) for rocks in every.values())
        self.of = {arm: rocks for arm, rocks in every.items() if len(rocks) == most}
        self.of_some = {arm: rocks for arm, rocks in every.items() if len(rocks) < most}
        self.rocks = sorted(set.intersection(*(set(rocks) for rocks in self.of.values())))

    @functools.cache  # noqa: B019
    def orbits(self) -> list[tuple[str, int]]:
        """The fixed plans that all rocks have, fewest photographs first."""
        plans = [(arm, n) for arm in FIXED if arm in self.of for n in COUNTS]
        return sorted(
            (p for p in plans if all(p[1] in self.of[p[0]][r] for r in self.rocks)), key=lambda p: p[1]
        )

    @functools.cache  # noqa: B019  there are two of them
    def reached(self, score: float) -> Bools:
        """(P, R) which rocks each of `orbits` brings to ``score``."""
        return np.array([self.at(*plan) >= score for plan in self.orbits()])

    @functools.cache  # noqa: B019
    def at(self, arm: str, count: int) -> Floats:
        """(R,) F-scores after so many photographs."""
        return np.array([self.of[arm][rock][count] for rock in self.rocks])

    def stopped(self, arm: str, threshold: float) -> tuple[Floats, Floats]:
        """(R,) photographs and (R,) F-scores where the prediction first reaches ``threshold`` percent; else at the end."""
        ends = []
        for rock in self.rocks:
            steps, told = sorted(self.of[arm][rock].items()), self.told[arm][rock]
            ends.append(next((step for step in steps if told[step[0]] >= threshold), steps[-1]))
        return np.array([n for n, _ in ends], dtype=float), np.array([f for _, f in ends])

    def by_height(self, slope: float, score: float) -> tuple[Ints, Bools]:
        """(L, R) photographs of two rings that go by what is believed of the height, by `LEVELS`, and who then has ``score``."""
        believed_m = np.array([self.believed_m[rock] for rock in self.rocks])
        wanted = LEVELS[:, None] + slope * np.log(believed_m)
        count = np.array(COUNTS)[np.minimum(np.searchsorted(COUNTS, wanted), len(COUNTS) - 1)]
        scores = np.array([self.at(TWO_RINGS, n) for n in COUNTS])
        return count, scores[np.searchsorted(COUNTS, count), np.arange(len(self.rocks))] >= score

    def needed(self, arm: str, score: float) -> Floats:
        """(R,) photographs after which a rock first has ``score``; `MOST` where it never has: an end that knows the rock."""
        return np.array(
            [
                min((n for n, f in self.of[arm][rock].items() if f >= score), default=MOST)
                for rock in self.rocks
            ],
            dtype=float,
        )


def interval(values: Floats) -> str:
    """Mean and its 95 % bootstrap interval."""
    rng = np.random.default_rng(0)
    means = values[rng.integers(0, len(values), (BOOTSTRAP, len(values)))].mean(axis=1)
    low, high = np.percentile(means, [2.5, 97.5])
    return f"{values.mean():+.2f} [{low:+.2f}, {high:+.2f}]"


def fewest_planned(curves: Curves, arm: str, share: float, score: float, rocks: Ints) -> int:
    """The fewest of `COUNTS` after which a planned arm has brought ``share`` of the rocks (indices) to ``score``."""
    enough = (n for n in COUNTS if float((curves.at(arm, n)[rocks] >= score).mean()) >= share - 1e-9)
    return next(enough, COUNTS[-1])


def fewest(curves: Curves, share: float, score: float, rocks: Ints) -> tuple[str, int]:
    """The fixed plan with fewest photographs that brings ``share`` of the rocks (indices) to ``score``; else the largest."""
    enough = np.flatnonzero(curves.reached(score)[:, rocks].mean(axis=1) >= share - 1e-9)
    return curves.orbits()[enough[0] if len(enough) else -1]


def chosen_threshold(train: Curves, score: float) -> float:
    """The predicted F-score that, as a stop, flies fewest photographs for those of the fixed plan with the same share.

    Of those that bring at least `OF_THE_ORBIT` of what the largest orbits do to ``score``.
    """
    everyone = np.arange(len(train.rocks))
    most = max(float((train.at(*plan) >= score).mean()) for plan in train.orbits())
    best = (np.inf, 100.0)
    for percent in np.arange(92.0, 99.6, 0.25):
        count, reached = train.stopped("adaptive", float(percent))
        share = float((reached >= score).mean())
        if share >= OF_THE_ORBIT * most:
            best = min(best, (count.mean() / fewest(train, share, score, everyone)[1], float(percent)))
    return best[1]


def chosen_rule(train: Curves, score: float) -> tuple[float, float]:
    """Level and slope of the two rings that go by the believed height, chosen as `chosen_threshold` is."""
    everyone = np.arange(len(train.rocks))
    most = max(float((train.at(*plan) >= score).mean()) for plan in train.orbits())
    best = (np.inf, 0.0, 0.0)
    for slope in SLOPES:
        count, reached = train.by_height(float(slope), score)
        for level, n, share in zip(LEVELS, count.mean(axis=1), reached.mean(axis=1), strict=True):
            if share >= OF_THE_ORBIT * most:
                best = min(best, (n / fewest(train, share, score, everyone)[1], float(level), float(slope)))
    return best[1:]


def fewest_by_height(count: Ints, reached: Bools, share: float) -> float:
    """Mean photographs of the lowest level (L, R) that brings ``share`` of the R rocks to the score; else of the highest."""
    enough = np.flatnonzero(reached.mean(axis=1) >= share - 1e-9)
    return float(count[enough[0] if len(enough) else -1].mean())


def at_equal_share(curves: Curves, threshold: float, slope: float, score: float, rocks: Ints) -> str:
    """Photographs of the stopped mission, and of the fewest by height and of the fewest fixed plan with no smaller a share."""
    count, reached = curves.stopped("adaptive", threshold)
    return against_controls(curves, "adaptive", count, reached >= score, slope, score, rocks)


def against_controls(
    curves: Curves, name: str, count: Floats, reached: Bools, slope: float, score: float, rocks: Ints
) -> str:
    """(R,) photographs and who reaches the score, of the rocks (indices), against the controls at its share."""
    by_height = curves.by_height(slope, score)

    def ratios(of: Ints) -> tuple[float, float]:
        share, mean = float(reached[of].mean()), float(count[of].mean())
        tall = fewest_by_height(by_height[0][:, of], by_height[1][:, of], share)
        return mean / tall, mean / fewest(curves, share, score, of)[1]

    rng = np.random.default_rng(0)
    draws = [ratios(rocks[rng.integers(0, len(rocks), len(rocks))]) for _ in range(BOOTSTRAP)]
    low, high = np.percentile(draws, [2.5, 97.5], axis=0)
    of_height, of_fixed = ratios(rocks)
    share, mean = reached[rocks].mean(), count[rocks].mean()
    arm, fixed = fewest(curves, float(share), score, rocks)
    return (
        f"{len(rocks)} rocks, share {share:.3f}: {name} {mean:.1f}; by height {mean / of_height:.1f}, "
        f"{of_height:.2f} [{low[0]:.2f}, {high[0]:.2f}]; {arm} {fixed}, {of_fixed:.2f} [{low[1]:.2f}, {high[1]:.2f}]"
    )


def tell(train: Curves, test: Curves, score: float) -> list[str]:
    """The comparison at equal share, then at equal number, as lines."""
    threshold, everyone = chosen_threshold(train, score), np.arange(len(test.rocks))
    level, slope = chosen_rule(train, score)
    family = np.array([rock.rpartition("-")[0] for rock in test.rocks])
    lines = [f"{len(train.rocks)} train rocks: stop at a predicted {threshold:g} %"]
    lines.append(f"all: {at_equal_share(test, threshold, slope, score, everyone)}")
    lines.append(f"rule of the train rocks: two rings of {level:g} + {slope:g} ln(believed height / m)")
    of_rule = [values[np.searchsorted(LEVELS, level)] for values in test.by_height(slope, score)]
    lines.append(f"all: {against_controls(test, 'rule', of_rule[0], of_rule[1], slope, score, everyone)}")
    for percent in np.arange(96.5, 99.01, 0.25):
        lines.append(f"stop at {percent:g}: {at_equal_share(test, float(percent), slope, score, everyone)}")
    for name in sorted(set(family)):
        own = np.flatnonzero(family == name)
        lines.append(f"{name}: {at_equal_share(test, threshold, slope, score, own)}")
    lines.append(
        f"without clefts: {at_equal_share(test, threshold, slope, score, np.flatnonzero(family != 'cleft'))}"
    )
    for plan, n in test.orbits():
        at = test.at(plan, n)
        lines.append(f"  {n} by {plan}: share {(at >= score).mean():.2f}, mean {at.mean():.2f}")
    rng = np.random.default_rng(0)
    ceiling = max(float((test.at(*plan) >= score).mean()) for plan in test.orbits())
    ratios = []
    for _ in range(BOOTSTRAP):
        draw = rng.integers(0, len(test.rocks), len(test.rocks))
        most = float(test.reached(score)[:, draw].mean(axis=1).max())
        ratios.append(
            fewest_planned(test, "adaptive", most, score, draw) / fewest(test, most, score, draw)[1]
        )
    low, high = np.percentile(ratios, [2.5, 97.5])
    mine, fixed = (
        fewest_planned(test, "adaptive", ceiling, score, everyone),
        fewest(test, ceiling, score, everyone)[1],
    )
    lines.append(
        f"at the largest share of a fixed plan, {ceiling:.2f}, one number for all rocks: adaptive {mine}, fixed {fixed},"
        f" {mine / fixed:.2f} [{low:.2f}, {high:.2f}]"
    )
    for n in (16, 20, 24, 28, 32, 40):
        best = max((plan for plan in test.orbits() if plan[1] == n), key=lambda p: train.at(*p).mean())
        own, its = test.at("adaptive", n), test.at(*best)
        lines.append(
            f"{n} photographs: adaptive {own.mean():.2f}, {best[0]} {its.mean():.2f}, gain {interval(own - its)},"
            f" share {(own >= score).mean():.2f} against {(its >= score).mean():.2f}"
        )
    for name in [a for a in PLANNED if a in test.of]:
        reached = np.array([max(test.of[name][r].values()) for r in test.rocks]) >= score
        lines.append(
            f"{name}, ended by one who knows the score: {test.needed(name, score).mean():.1f} photographs, share"
            f" {reached.mean():.2f}"
        )
    for name, rocks in test.of_some.items():
        for n in (20, 24, 40):
            gain = [test.of["adaptive"][rock][n] - scores[n] for rock, scores in rocks.items()]
            lines.append(
                f"{n} photographs: adaptive less {name} {interval(np.array(gain))}, {len(rocks)} rocks"
            )
    knows = np.array(
        [
            min((n for plan, n in test.orbits() if test.of[plan][r][n] >= score), default=MOST)
            for r in test.rocks
        ]
    )
    lines.append(f"the best fixed plan of each rock, by one who knows it: {knows.mean():.1f} photographs")
    never = [r for r in test.rocks if max(f for a in test.of.values() for f in a[r].values()) < score]
    lines.append(f"never at {score:g} with any plan: {', '.join(never)}")
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    commands = parser.add_subparsers(dest="what", required=True)
    running = commands.add_parser("curves")
    running.add_argument("--split", choices=("train", "validation", "held-out"), default="train")
    running.add_argument("--rocks", type=int, default=4)
    running.add_argument("--first", type=int, default=0, help="seeds of the split to leave out before")
    running.add_argument("--arms", nargs="+", default=[*FIXED, *PLANNED])
    running.add_argument("--seeds", type=int, default=SEEDS["seed.count"])
    running.add_argument("--seed-elevation-deg", type=float, default=SEEDS["seed.lowest_deg"])
    running.add_argument("--out", type=Path, required=True)
    bounding = commands.add_parser("bounds")
    bounding.add_argument("--rock", nargs="+", required=True)
    telling = commands.add_parser("tell")
    telling.add_argument("file", type=Path)
    telling.add_argument("--score", type=float, default=98.0)
    arguments = parser.parse_args()
    if arguments.what == "tell":
        rows = read(arguments.file)
        held_out = [int(row["rock"].rpartition("-")[2]) >= HELD_OUT_FROM for row in rows]
        train = Curves(row for row, held in zip(rows, held_out, strict=True) if not held)
        test = Curves(itertools.compress(rows, held_out))
        print("\n".join(tell(train, test, arguments.score)))
        return
    if arguments.what == "bounds":
        print(*BOUNDS, sep=",")
        for rock in arguments.rock:
            print(*bounds(rock), sep=",", flush=True)
        return
    seeds = {"seed.count": arguments.seeds, "seed.lowest_deg": arguments.seed_elevation_deg}
    fresh = not arguments.out.exists()
    evaluated = set() if fresh else {row["rock"] for row in read(arguments.out)}
    with arguments.out.open("a", newline="") as file:
        writer = csv.writer(file)
        if fresh:
            writer.writerow(HEAD)
        for rock in rocks_of(arguments.split, arguments.rocks, arguments.first):
            if rock not in evaluated:
                writer.writerows(curves(rock, arguments.arms, seeds))
                file.flush()


def read(path: Path) -> list[dict[str, str]]:
    with path.open() as file:
        return list(csv.DictReader(file))


if __name__ == "__main__":
    main()
