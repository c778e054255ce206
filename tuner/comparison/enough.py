"""How few of the photographs of a set would have done: which missions answer that, and how they are read.

Strategies that choose photographs (an even ring, random ones, planners) run at several numbers of photographs, with
replicates that begin elsewhere; all but the ring begin with the same seeds. One more mission takes all photographs. A plan is
enough where the lower bound of its quality over the replicates keeps the asked share of what all photographs reach.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from nbv.config import MissionConfig, preset
from nbv.errors import UserError
from nbv.photographs import PhotographSet
from tuner.comparison.plan import EvaluationPlan
from tuner.comparison.run import EvaluationRun
from tuner.missions.registry import PHOTOGRAPHS
from tuner.problem.baselines import PLANNER, baseline, with_sections_of
from tuner.problem.baselines import photographs as taken_by
from tuner.problem.intervals import Interval, mean_interval
from tuner.problem.objective import DEFAULT_METRIC

NUMBERS = (16, 20, 24, 32, 48)
SEEDS = 16  # 22.5 degrees apart: farther, and SIFT holds too few of them together
ALL, RING = "all", "ring"
WAYS = {
    RING: "even ring",
    "random": "random",
    "hyb-h": "Hyb-H, the paper's planner",
    "tuned": "tuned planner",
}
SECONDS_PER_PHOTOGRAPH = 0.5  # of one processor, features known (docs/results/real_photographs.md)
# Poses are known from the import, so they may hold the seeds together as a GNSS receiver's would.
TELEMETRY = "rtk"
_BELOW_ALL_M = -3.0


@dataclass(frozen=True)
class Point:
    """One strategy at one number of photographs."""

    photographs: float  # taken, mean over replicates
    registered: float
    quality: Interval  # within 0 to 100


@dataclass(frozen=True)
class Smallest:
    """The plan of fewest photographs whose lower bound kept what was asked for, and its mission of median quality."""

    way: str
    plan: Point
    replicate: int
    quality: float  # of that mission
    taken: tuple[str, ...]  # names in the set, in the order taken


@dataclass(frozen=True)
class Enough:
    """Quality over the number of photographs, and the smallest plan that is enough."""

    all_photographs: float  # how many may be taken
    all_quality: float
    asked_quality: float
    ceiling: float  # one half of the photographs against the other
    curves: Mapping[str, tuple[Point, ...]]  # by way
    smallest: Smallest | None


def enough_plans(
    photographs: PhotographSet,
    numbers: Sequence[int] = NUMBERS,
    replicates: int = 3,
    tuned: MissionConfig | None = None,
    overrides: Mapping[str, Any] | None = None,
) -> dict[str, EvaluationPlan]:
    """The mission that takes all photographs, and the missions of the curves, by folder.

    ``numbers`` of photographs that the set does not have are left out; ``tuned`` is a configuration whose gate and scorers run
    as "tuned", by default our own scorer; ``overrides`` hold for every mission. `UserError` where the set has too few
    photographs for the fewest of ``numbers``, or there is one replicate only.
    """
    if replicates < 2:
        raise UserError("--replicates must be 2 or more: the lower bound needs their spread")
    registered = len(photographs.registered)
    sizes = sorted({n for n in numbers if SEEDS <= n < registered})
    if not sizes:
        raise UserError(
            f"{photographs.name} has {registered} photographs to choose from; give --number at least {SEEDS} and fewer "
            "than that"
        )
    elevation_deg = float(np.median(photographs.coverage.elevations_deg))
    base = preset("campaign").with_values(
        {
            "telemetry": TELEMETRY,
            "seed.lowest_deg": round(min(max(elevation_deg, 0.0), 60.0), 1),
            "pool.min_altitude_m": _BELOW_ALL_M,
            **(overrides or {}),
        }
    )
    planner = tuned or baseline("predicted").config(base)
    strategies = {}
    for number in sizes:
        ring = base.with_values({"seed.count": number, "stop.adaptive_budget": 0})
        shared = base.with_values({"seed.count": SEEDS, "stop.adaptive_budget": number - SEEDS})
        strategies[_name(RING, number)] = ring
        if number == SEEDS:
            continue
        for way in WAYS:
            if way == "tuned":
                strategies[_name(way, number)] = with_sections_of(planner, PLANNER, shared)
            elif way != RING:
                strategies[_name(way, number)] = shared.with_values({"gate.kind": way})
    everything = base.with_values(
        {
            "seed.count": SEEDS,
            "stop.adaptive_budget": registered,
            "stop.criterion": "budget",
            "gate.kind": "movement-only",
        }
    )
    rocks = (photographs.name,)
    return {
        "all": EvaluationPlan({ALL: everything}, rocks, 1, fidelity=PHOTOGRAPHS),
        "few": EvaluationPlan(strategies, rocks, replicates, fidelity=PHOTOGRAPHS),
    }


def read_enough(everything: EvaluationRun, curves: EvaluationRun, keep_percent: float) -> Enough:
    """The curves of the two evaluations of `enough_plans`, and the plan of fewest photographs that keeps enough quality.

    ``keep_percent`` is of the quality with all photographs. A failed mission counts as a quality of 0. `UserError` where the
    mission with all photographs failed.
    """
    whole = next(iter(everything.records), None)
    reached = None if whole is None else whole.value(DEFAULT_METRIC)
    if whole is None or reached is None:
        why = "" if whole is None else f" ({whole.reason}: {whole.record.message})"
        raise UserError(f"the mission with all photographs gave no {DEFAULT_METRIC}{why}")
    least = keep_percent / 100.0 * reached
    ways: dict[str, list[Point]] = {way: [] for way in WAYS}
    smallest, smallest_rank = None, (math.inf, 0.0)
    for strategy in curves.plan.strategies:
        way, trials = strategy.rpartition("-")[0], [t for t in curves.records if t.strategy == strategy]
        qualities = [t.value(DEFAULT_METRIC) or 0.0 for t in trials]
        interval = mean_interval({"set": qualities})
        if interval is None or interval.low is None or interval.high is None:
            continue  # not run to the end
        low, high = max(0.0, interval.low), min(100.0, interval.high)
        interval = dataclasses.replace(interval, low=low, high=high)
        images, registered = (
            float(np.mean([trial.costs.get(key, 0.0) for trial in trials]))
            for key in ("images", "registered_images")
        )
        point = Point(images, registered, interval)
        ways[way].append(point)
        if low >= least and (images, -low) < smallest_rank:
            median = sorted(range(len(trials)), key=qualities.__getitem__)[len(trials) // 2]
            typical = trials[median]
            taken = tuple(typical.metrics.get("taken", ()))
            smallest = Smallest(way, point, typical.replicate, qualities[median], taken)
            smallest_rank = images, -low
    return Enough(
        whole.costs["images"],
        reached,
        least,
        whole.metrics["reference"]["ceiling"].get("f_score_48mm", math.nan),
        {way: tuple(sorted(points, key=lambda p: p.photographs)) for way, points in ways.items() if points},
        smallest,
    )


def seconds(plans: Iterable[EvaluationPlan], photographs: PhotographSet) -> float:
    """An estimate of the processor time of these plans' missions, in seconds."""
    most = len(photographs.registered)
    configs = [(config, plan.replicates) for plan in plans for config in plan.strategies.values()]
    return SECONDS_PER_PHOTOGRAPH * sum(n * min(most, taken_by(c)) for c, n in configs)


def _name(way: str, number: int) -> str:
    return f"{way}-{number}"
