"""Strategies against each other in the layout of the paper's Table I: means and paired differences, with intervals.

Intervals say what they generalise to: to unseen rocks, or to new replicates on these. The paper's own numbers are as printed: one
mission per strategy, distances in mm, shares in percent.
"""

from __future__ import annotations

import collections
import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property

from nbv.evaluation.registry import find_metric
from tuner.comparison.of_campaign import PlannedComparison
from tuner.comparison.plan import EvaluationRun
from tuner.missions.job import Trial
from tuner.problem.baselines import ANSWERS, PAPER_STRATEGIES, in_table_order
from tuner.problem.goal import Goal, Objective
from tuner.problem.intervals import Interval, mean_interval
from tuner.problem.observations import Block


@dataclass(frozen=True)
class MetricRow:
    """One line of a table in the layout of Table I."""

    group: str
    label: str  # empty: the metric's usual name
    key: str  # path of the metric, with the surface as its first part
    unit: str
    higher_is_better: bool
    decimals: int | None = 1  # None: as its spread deserves


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


def values_of(records: Sequence[Trial], strategy: str, key: str) -> dict[Block, float]:
    """A metric by block, failed missions as `score_of` counts them."""
    objective = Objective(key, "maximise")
    values = {(r.instance, r.replicate): score_of(r, objective) for r in records if r.strategy == strategy}
    return {block: value for block, value in values.items() if value is not None}


def strategy_interval(records: Sequence[Trial], strategy: str, key: str) -> Interval | None:
    """Mean of a metric over rocks, with its interval; None without a mission that has it."""
    return over_rocks(values_of(records, strategy, key))


def strategy_difference(records: Sequence[Trial], strategy: str, reference: str, key: str) -> Interval | None:
    """Mean over rocks of a metric minus that of ``reference``, on the blocks that both finished.

    The ``missions`` of the interval are these pairs. None without one.
    """
    ours, theirs = (values_of(records, name, key) for name in (strategy, reference))
    return over_rocks({block: ours[block] - theirs[block] for block in sorted(ours.keys() & theirs.keys())})


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
    same: dict[str, str]  # by strategy an earlier one whose photographs it took in every mission


def same_photographs(
    records: Sequence[Trial], strategies: Sequence[str], *, on_common: bool = False
) -> dict[str, str]:
    """Return the strategies whose missions all took the photographs of an earlier strategy's, with that strategy.

    ``on_common``: of the blocks that both finished, where strategies may have flown on different ones.
    """
    taken: dict[str, dict[Block, str]] = {name: {} for name in strategies}
    for r in records:
        if r.strategy in taken and r.record.status != "failed":
            taken[r.strategy][r.instance, r.replicate] = r.record.photographs
    twins: dict[str, str] = {}
    for i, name in enumerate(strategies):
        for earlier in strategies[:i]:
            views, theirs = taken[name], taken[earlier]
            if on_common:
                both = views.keys() & theirs.keys()
                views, theirs = {b: views[b] for b in both}, {b: theirs[b] for b in both}
            if views and all(views.values()) and views == theirs:
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
        cells = {name: strategy_interval(records, name, metric.key) for name in strategies}
        paired = {name: strategy_difference(records, name, reference, metric.key) for name in strategies}
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
        same_photographs(records, strategies),
    )


# Whether one strategy is better than another: an enumeration with numbers, which pages and terminal put into words.


class Kind(StrEnum):
    """What a paired difference and its 95 % interval say."""

    BETTER = "better"
    WORSE = "worse"
    NO_DIFFERENCE = "no difference"  # detected
    NO_INTERVAL = "no interval"  # too few missions
    NOT_PAIRED = "not paired"  # no mission in common
    SAME = "same photographs"  # in every mission


@dataclass(frozen=True)
class Verdict:
    kind: Kind
    strategy: str
    reference: str
    metric: str
    gain: Interval | None  # positive where it is better; None: not paired


def judge(records: Sequence[Trial], strategy: str, reference: str, objective: Objective) -> Verdict:
    """Return the verdict on ``strategy`` from the blocks that both finished."""
    d = strategy_difference(records, strategy, reference, objective.metric)
    if d is None:
        return Verdict(Kind.NOT_PAIRED, strategy, reference, objective.metric, None)
    gain = d if objective.direction == "maximise" else d.reversed
    return Verdict(kind_of(gain), strategy, reference, objective.metric, gain)


def kind_of(gain: Interval) -> Kind:
    """Return the kind of a difference that is oriented so that positive is better."""
    if gain.low is None or gain.high is None:
        return Kind.NO_INTERVAL
    return Kind.BETTER if gain.low > 0 else Kind.WORSE if gain.high < 0 else Kind.NO_DIFFERENCE


# What strategies that ran against each other have: tables, and verdicts with their numbers.
#
# `tuner.report.comparison` puts these into words, for terminal, pages and JSON.


_COSTS = (
    MetricRow("", "photos", "costs.images", "", False, 0),
    MetricRow("", "flight", "costs.flight_time_s", "s", False, 0),
)
_QUALITY = (
    MetricRow("", "F 48", "observable.f_score_48mm", "%", True),
    MetricRow("", "F 80", "observable.f_score_80mm", "%", True),
    MetricRow("", "C 48", "observable.completeness_48mm", "%", True),
    MetricRow("", "C 80", "observable.completeness_80mm", "%", True),
    MetricRow("", "C2C", "observable.c2c_mean_mm", "mm", False),
)


def row_of(o: Objective) -> MetricRow:
    """A table row of any metric, which is labelled and rounded where it is shown."""
    return MetricRow("", "", o.metric, "", o.direction == "maximise", None)


def by_strategy(
    records: Sequence[Trial], strategies: Sequence[str], reference: str, goal: Goal
) -> ComparisonTable:
    """Costs, the objectives and the usual measures of a cloud.

    What no mission has is left out. Missions of a plug-in's fidelity may have their own costs.
    """
    objectives = [row_of(o) for o in (goal.shown, *goal.objectives)]
    if not any("images" in r.costs for r in records):
        costs = sorted({f"costs.{name}" for r in records for name in r.costs})
        objectives += [row_of(Objective(name, "minimise")) for name in costs]
    rows = {row.key: row for row in (*_COSTS, *objectives)} | {row.key: row for row in (*_COSTS, *_QUALITY)}
    table = comparison_table(records, strategies, reference, list(rows.values()))
    shown = [row for row in table.rows if any(row.cells.values())]
    return dataclasses.replace(table, rows=shown)


class ComparisonFacts:
    """What a comparison found: tables, from the shortest to the longest, and verdicts."""

    def __init__(self, planned: PlannedComparison, run: EvaluationRun) -> None:
        self.planned, self.run = planned, run
        self.plan, self.records = run.plan, run.records
        self.reference, self.goal = planned.reference, planned.goal
        self.strategies = tuple(in_table_order(self.plan.strategies))

    @cached_property
    def tables(self) -> dict[str, ComparisonTable]:
        """Table I by surface; empty where no mission has those metrics."""
        rows = {"whole": TABLE_I_ROWS, "observable": TABLE_I_ROWS_OBSERVABLE}
        return {
            name: comparison_table(self.records, self.strategies, self.reference, of)
            for name, of in rows.items()
            if any("whole" in r.metrics for r in self.records)
        }

    @cached_property
    def summary(self) -> ComparisonTable:
        """All strategies over all conditions."""
        return by_strategy(self.records, self.strategies, self.reference, self.goal)

    @cached_property
    def conditions(self) -> dict[str, ComparisonTable]:
        """The same, condition by condition; empty where there is one."""
        names = [c.name for c in self.plan.conditions]
        return {
            name: by_strategy(
                [r for r in self.records if r.condition == name], self.strategies, self.reference, self.goal
            )
            for name in names
            if len(names) > 1
        }

    @cached_property
    def verdicts(self) -> list[Verdict]:
        """On the tuned strategies, without one on the paper's, against the reference."""
        others = [name for name in self.plan.strategies if name != self.reference]
        subjects = [name for name in others if name in ANSWERS]
        subjects = subjects or [name for name in others if name in PAPER_STRATEGIES] or others[:1]
        out, metric = list[Verdict](), self.goal.shown
        for name in subjects:
            if self.plan.owners[name] == self.plan.owners[self.reference]:
                continue
            if same_photographs(self.records, (self.reference, name)):
                out.append(Verdict(Kind.SAME, name, self.reference, metric.metric, None))
            else:
                out.append(judge(self.records, name, self.reference, metric))
        return out
