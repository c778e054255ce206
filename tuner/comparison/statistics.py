"""Strategies against each other in the layout of the paper's Table I: means and paired differences, with intervals.

Intervals say what they generalise to: to unseen rocks, or to new replicates on these. The paper's own numbers are as printed: one
mission per strategy, distances in mm, shares in percent.
"""

from __future__ import annotations

import collections
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum

from nbv.evaluation.registry import find_metric
from tuner.missions.job import Trial
from tuner.problem.goal import Objective
from tuner.problem.intervals import Interval, mean_interval
from tuner.problem.observations import Block


@dataclass(frozen=True)
class MetricRow:
    """One line of a table in the layout of Table I."""

    group: str
    label: str
    key: str  # path of the metric, with the surface as its first part
    unit: str
    higher_is_better: bool


_DISTANCES, _AT_48, _AT_80 = "Dense cloud vs. GT", "Thresholded @ 48 mm", "Thresholded @ 80 mm"
TABLE_I_ROWS, TABLE_I_ROWS_OBSERVABLE = (
    (
        MetricRow(_DISTANCES, "Hausdorff", f"{surface}.hausdorff_gt_to_cloud_mm", "mm", False),
        MetricRow(_DISTANCES, "Mean C2C", f"{surface}.c2c_mean_mm", "mm", False),
        MetricRow(_DISTANCES, "Median C2C", f"{surface}.c2c_median_mm", "mm", False),
        MetricRow(_DISTANCES, "P95 C2C", f"{surface}.c2c_p95_mm", "mm", False),
        MetricRow(_AT_48, "Completeness", f"{surface}.completeness_48mm", "%", True),
        MetricRow(_AT_48, "F-score", f"{surface}.f_score_48mm", "%", True),
        MetricRow(_AT_80, "Completeness", f"{surface}.completeness_80mm", "%", True),
        MetricRow(_AT_80, "F-score", f"{surface}.f_score_80mm", "%", True),
    )
    for surface in ("whole", "observable")
)
# Torre et al., Table I. Columns: Covis, B-aware, Hyb-H, Hyb-O.
PAPER_TABLE_I: dict[str, dict[str, float]] = {
    strategy: dict(zip((row.key for row in TABLE_I_ROWS), column))
    for strategy, column in {
        "covis": (480.9, 66.0, 39.0, 245.6, 56.0, 72.0, 75.0, 86.0),
        "b-aware": (522.6, 79.4, 48.9, 293.0, 49.0, 66.0, 67.0, 80.0),
        "hyb-h": (535.1, 79.7, 47.3, 298.4, 50.0, 67.0, 66.0, 79.5),
        "hyb-o": (465.1, 59.8, 38.7, 223.3, 59.0, 73.0, 80.0, 89.0),
    }.items()
}


def score_of(record: Trial, objective: Objective) -> float | None:
    """Return a mission's metric; of a failed mission 0 where that is the worst (a percentage that should be high), else None."""
    value = record.measured(objective)
    if value is None and record.record.status == "failed" and objective.direction == "maximise":
        metric = find_metric(objective.metric.rpartition(".")[2])
        return 0.0 if metric is not None and metric[0].unit == "%" else None
    return value


def values_of(records: Sequence[Trial], strategy: str, objective: Objective) -> dict[Block, float]:
    """A metric by block, failed missions as `score_of` counts them."""
    values = {(r.instance, r.replicate): score_of(r, objective) for r in records if r.strategy == strategy}
    return {block: value for block, value in values.items() if value is not None}


def strategy_gain(
    records: Sequence[Trial], strategy: str, reference: str, objective: Objective
) -> Interval | None:
    """Mean over rocks of what a strategy has over ``reference`` on the blocks that both finished, positive where it is better.

    The ``missions`` of the interval are these pairs. None without one.
    """
    ours, theirs = (values_of(records, name, objective) for name in (strategy, reference))
    both, sign = sorted(ours.keys() & theirs.keys()), objective.sign
    return over_rocks({block: sign * (ours[block] - theirs[block]) for block in both})


def over_rocks(values: Mapping[Block, float]) -> Interval | None:
    """Return the mean over rocks of values by block, with its interval; None without one."""
    by_rock: dict[str, list[float]] = {}
    for (instance, _), value in values.items():
        by_rock.setdefault(instance.rock, []).append(value)
    return mean_interval(by_rock)


def rock_floor(records: Sequence[Trial], metric: MetricRow) -> float | None:
    """Mean over rocks of what a perfect reconstruction would get (``nbv.evaluation.ground_truth``).

    A property of the rocks, so missions of all strategies may tell it. None where no mission holds it.
    """
    by_rock, key = dict[str, float](), metric.key.removesuffix("_mm") + "_floor_mm"
    for r in records:
        value = r.value(key)
        if value is not None:
            by_rock[r.rock] = value
    return sum(by_rock.values()) / len(by_rock) if by_rock else None


@dataclass(frozen=True)
class ComparisonRow:
    metric: MetricRow
    cells: dict[str, Interval | None]  # by strategy
    best: tuple[str, ...]  # strategies with the best paired difference (several when equal)
    floor: float | None  # what a perfect reconstruction would get, mean over rocks; None for most metrics
    differences: dict[str, Interval | None]  # paired, from the reference, which is left out


@dataclass(frozen=True)
class ComparisonTable:
    """A table in the layout of the paper's Table I, with intervals and paired differences."""

    strategies: tuple[str, ...]
    reference: str
    rows: list[ComparisonRow]
    missions: dict[str, int]  # with metrics, by strategy
    failures: dict[str, int]  # failed missions, by strategy


def same_photographs(records: Sequence[Trial], strategies: Sequence[str]) -> dict[str, str]:
    """Return the strategies that took an earlier strategy's photographs on all pairs of both, with that strategy."""
    taken: dict[str, dict[Block, str]] = {name: {} for name in strategies}
    for r in records:
        if r.strategy in taken and r.record.status != "failed":
            taken[r.strategy][r.instance, r.replicate] = r.record.photographs
    twins: dict[str, str] = {}
    for i, name in enumerate(strategies):
        for earlier in strategies[:i]:
            both = taken[name].keys() & taken[earlier].keys()
            if both and all(taken[name][b] and taken[name][b] == taken[earlier][b] for b in both):
                twins[name] = twins.get(earlier, earlier)
                break
    return twins


def comparison_table(
    records: Sequence[Trial],
    strategies: Sequence[str],
    reference: str,
    rows: Sequence[MetricRow] = TABLE_I_ROWS,
) -> ComparisonTable:
    """Means with intervals per strategy, and paired differences from ``reference``, one of the strategies."""
    table = []
    for metric in rows:
        of = Objective(metric.key, "maximise")  # differences: strategy minus reference, whichever is better
        cells = {name: over_rocks(values_of(records, name, of)) for name in strategies}
        paired = {name: strategy_gain(records, name, reference, of) for name in strategies}
        means = {name: difference.mean for name, difference in paired.items() if difference is not None}
        pick = max if metric.higher_is_better else min
        best = tuple(name for name, mean in means.items() if mean == pick(means.values()))
        differences = {name: difference for name, difference in paired.items() if name != reference}
        table.append(ComparisonRow(metric, cells, best, rock_floor(records, metric), differences))
    counts = collections.Counter(r.strategy for r in records if r.record.status != "failed")
    failures = collections.Counter(r.strategy for r in records if r.record.status == "failed")
    return ComparisonTable(
        tuple(strategies),
        reference,
        table,
        {name: counts[name] for name in strategies},
        {name: failures[name] for name in strategies},
    )


class Verdict(StrEnum):
    """What a paired difference and its 95 % interval say."""

    BETTER = "better"
    WORSE = "worse"
    NO_DIFFERENCE = "no difference"  # detected
    NO_INTERVAL = "no interval"  # too few missions
    NOT_PAIRED = "not paired"  # no mission in common


def kind_of(gain: Interval | None) -> Verdict:
    """Return the kind of a difference that is oriented so that positive is better; None: no mission in common."""
    if gain is None:
        return Verdict.NOT_PAIRED
    if gain.low is None or gain.high is None:
        return Verdict.NO_INTERVAL
    return Verdict.BETTER if gain.low > 0 else Verdict.WORSE if gain.high < 0 else Verdict.NO_DIFFERENCE
