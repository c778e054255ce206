"""How few of the photographs of a set would have done: which missions answer that, how they are read, and what is told.

Strategies that choose photographs (an even ring, random ones, planners) run at several numbers of photographs, with
replicates that begin elsewhere; all but the ring begin with the same seeds. One more mission takes all photographs. A plan is
enough where the lower bound of its quality over the replicates keeps the asked share of what all photographs reach, and so
does the mean of every larger number. Where one side was not photographed the ring's places are closer, so that it has its
number.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from nbv.config import MissionConfig, preset
from nbv.errors import UserError
from nbv.photographs import PhotographSet
from nbv.photographs.photograph_set import gaps_deg
from tuner.comparison.plan import EvaluationPlan, EvaluationRun
from tuner.missions.job import Trial
from tuner.missions.registry import PHOTOGRAPHS
from tuner.problem.baselines import PLANNER, baseline, with_sections_of
from tuner.problem.goal import DEFAULT_METRIC
from tuner.problem.intervals import Interval, mean_interval
from tuner.report.figures import BLUE, GREY, LIGHT, MARKERS, look, new_figure, save_figure
from tuner.report.labels import Table, difference_text

NUMBERS = (16, 20, 24, 32, 48)
SEEDS = 16  # 22.5 degrees apart: farther, and SIFT holds too few of them together
ALL, RING = "all", "ring"
WAYS = {
    RING: "even ring",
    "random": "random",
    "hyb-h": "Hyb-H, the paper's planner",
    "tuned": "tuned planner",
}
SECONDS_PER_PHOTOGRAPH = 0.5  # of one processor, features known (docs/results/index.md)
# Poses are known from the import, so they may hold the seeds together as a GNSS receiver's would.
TELEMETRY = "rtk"
_BELOW_ALL_M = -3.0
_NEAR_DEG = 20.0  # a seed without a photograph so near in azimuth is left out


@dataclass(frozen=True)
class PlanResult:
    """One strategy at one number of photographs."""

    asked: int  # photographs
    photographs: float  # taken, mean over the missions that did not fail
    registered: float
    quality: Interval  # within 0 to 100
    failed: int  # missions
    why: str  # the first of them failed


@dataclass(frozen=True)
class Smallest:
    """The plan of fewest photographs whose lower bound kept what was asked for, and its mission of median quality."""

    way: str
    plan: PlanResult
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
    curves: Mapping[str, tuple[PlanResult, ...]]  # by way
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
    empty = ((high - low) % 360 - 2 * _NEAR_DEG for low, high in gaps_deg(photographs.coverage.azimuths_deg))
    photographed = 1 - sum(max(0.0, degrees) for degrees in empty) / 360
    seeds = round(SEEDS / photographed)
    base = preset("campaign").with_values(
        {
            "telemetry": TELEMETRY,
            "seed.layout": "turn",
            "seed.lowest_deg": round(min(max(elevation_deg, 0.0), 60.0), 1),
            "pool.min_altitude_m": _BELOW_ALL_M,
            **(overrides or {}),
        }
    )
    planner = tuned or baseline("predicted").config(base)
    strategies = {}
    for number in sizes:
        ring = base.with_values(_numbers(round(number / photographed), 0))
        shared = base.with_values(_numbers(seeds, number - SEEDS))
        strategies[f"{RING}-{number}"] = ring
        if number == SEEDS:
            continue
        for way in WAYS:
            if way == "tuned":
                strategies[f"{way}-{number}"] = with_sections_of(planner, PLANNER, shared)
            elif way != RING:
                strategies[f"{way}-{number}"] = shared.with_values({"gate.kind": way})
    everything = base.with_values(
        {**_numbers(seeds, registered), "stop.criterion": "budget", "gate.kind": "movement-only"}
    )
    rocks = (photographs.name,)
    return {
        "all": EvaluationPlan({ALL: everything}, rocks, 1, fidelity=PHOTOGRAPHS),
        "few": EvaluationPlan(strategies, rocks, replicates, fidelity=PHOTOGRAPHS),
    }


def _numbers(seeds: int, planned_views: int) -> dict[str, Any]:
    return {"photographs": seeds + planned_views, "seeds": seeds}


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
    ways: dict[str, list[tuple[PlanResult, list[Trial]]]] = {way: [] for way in WAYS}
    for strategy in curves.plan.strategies:
        trials = [t for t in curves.records if t.strategy == strategy]
        interval = mean_interval({"set": list(map(_quality, trials))})
        if interval is None or interval.low is None or interval.high is None:
            continue  # not run to the end
        interval = dataclasses.replace(interval, low=max(0.0, interval.low), high=min(100.0, interval.high))
        way, _, asked = strategy.rpartition("-")
        flown = [t for t in trials if t.value(DEFAULT_METRIC) is not None]
        images, registered = (
            float(np.mean([t.costs.get(key, 0.0) for t in flown])) if flown else 0.0
            for key in ("images", "registered_images")
        )
        why = next((f"{t.reason}: {t.record.message}" for t in trials if t not in flown), "")
        failed = len(trials) - len(flown)
        ways[way].append((PlanResult(int(asked), images, registered, interval, failed, why), trials))
    enough = []
    for way, points in ways.items():
        points.sort(key=lambda p: p[0].asked)
        for index, (point, trials) in enumerate(points):
            later = min((p.quality.mean for p, _ in points[index:]), default=0.0)
            if (point.quality.low or 0.0) >= least and later >= least:
                enough.append((point, way, trials))
    smallest = None
    if enough:
        point, way, trials = min(enough, key=lambda e: (e[0].photographs, -(e[0].quality.low or 0.0)))
        typical = sorted(trials, key=_quality)[len(trials) // 2]
        taken = tuple(typical.metrics.get("taken", ()))
        smallest = Smallest(way, point, typical.replicate, _quality(typical), taken)
    return Enough(
        whole.costs["images"],
        reached,
        least,
        whole.metrics["reference"]["ceiling"].get("f_score_48mm", math.nan),
        {way: tuple(point for point, _ in points) for way, points in ways.items() if points},
        smallest,
    )


def _quality(trial: Trial) -> float:
    return trial.value(DEFAULT_METRIC) or 0.0


def seconds(plans: Iterable[EvaluationPlan], photographs: PhotographSet) -> float:
    """An estimate of the processor time of these plans' missions, in seconds."""
    most = len(photographs.registered)
    configs = [(config, plan.replicates) for plan in plans for config in plan.strategies.values()]
    return SECONDS_PER_PHOTOGRAPH * sum(n * min(most, c.photographs) for c, n in configs)


def enough_table(enough: Enough) -> Table:
    rows = [
        (
            WAYS[way],
            f"{p.asked}",
            f"{p.photographs:.1f}" if p.photographs else "–",
            f"{p.registered:.1f}" if p.photographs else "–",
            difference_text(p.quality, signed=False) + (f", {p.failed} failed" if p.failed else ""),
        )
        for way, points in enough.curves.items()
        for p in points
    ]
    title = (
        f"F-score at 3 % of the height; one half of all photographs against the other: {enough.ceiling:.1f} %"
    )
    return Table.of(title, ("way", "asked", "photographs", "registered", "F-score, % [95 % interval]"), rows)


def enough_text(enough: Enough, keep_percent: float, listed: Path) -> str:
    """Why missions failed, and which plan would have been enough; ``listed``: the file that names its photographs."""
    why = dict.fromkeys(p.why for points in enough.curves.values() for p in points if p.why)
    text = "".join(f"Failed missions count as 0 ({reason}).\n" for reason in why)
    text += f"All {enough.all_photographs:.0f} have {enough.all_quality:.1f} %; {keep_percent:g} % of that are {enough.asked_quality:.1f} %."
    if (best := enough.smallest) is None:
        return f"{text} No plan's lower bound reached it: try a larger --number or more --replicates."
    return (
        f"{text} {best.plan.photographs:.0f} photographs would have been enough: {WAYS[best.way]}, "
        f"{difference_text(best.plan.quality, signed=False)} %. The files of a typical mission, {best.quality:.1f} %: {listed}."
    )


def draw_enough(enough: Enough, photographs: PhotographSet, keep_percent: float, path: Path) -> Path:
    """Write the picture as PNG; returns its path."""
    with look():
        figure = new_figure(7.2, 7.4)
        above, below = figure.subplots(2, 1, height_ratios=(3, 2))
        for k, (way, points) in enumerate(enough.curves.items()):
            number = np.array([p.photographs or p.asked for p in points])
            mean = np.array([p.quality.mean for p in points])
            above.plot(number, mean, "-", marker=MARKERS[k], color=f"C{k}", markersize=4, label=WAYS[way])
            bounds = np.array([(p.quality.low, p.quality.high) for p in points], dtype=float)  # None: NaN
            low, high = bounds.T
            above.fill_between(number, low, high, color=f"C{k}", alpha=0.12, lw=0)
        small = {"color": GREY, "fontsize": 8}
        left = above.get_xlim()[0]
        above.axhline(enough.all_quality, color=GREY, lw=1)
        above.axhline(enough.asked_quality, color=GREY, lw=1, ls=":")
        above.text(left, enough.all_quality, f" all {enough.all_photographs:.0f}", va="bottom", **small)
        above.text(left, enough.asked_quality, f" {keep_percent:g} % of that", va="top", **small)
        above.set_xlabel("photographs")
        above.set_ylabel("F-score at 3 % of the height, %")
        above.legend(loc="lower right")
        views = photographs.coverage
        azimuth, elevation = views.azimuths_deg, views.elevations_deg
        below.scatter(azimuth, elevation, s=14, color=LIGHT, edgecolor=GREY, lw=0.5, label="not needed")
        if enough.smallest is not None:
            chosen = np.isin(views.names, enough.smallest.taken)
            label = f"these {chosen.sum()} would have been enough"
            below.scatter(azimuth[chosen], elevation[chosen], s=22, color=BLUE, label=label)
        below.set_xlim(0, 360)
        below.set_xticks(range(0, 361, 45))
        below.set_xlabel("azimuth about the object, degrees")
        below.set_ylabel("elevation, degrees")
        below.legend(loc="upper right", ncols=2)
    return save_figure(figure, path.parent, path.stem)
