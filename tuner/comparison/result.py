"""What strategies that ran against each other have: tables, and verdicts with their numbers.

`tuner.report.comparison` puts these into words, for terminal, pages and JSON.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import cached_property

from tuner.comparison.of_campaign import PlannedComparison
from tuner.comparison.run import EvaluationRun
from tuner.comparison.statistics import (
    TABLE_I_ROWS,
    TABLE_I_ROWS_OBSERVABLE,
    ComparisonTable,
    MetricRow,
    comparison_table,
    same_photographs,
)
from tuner.comparison.verdict import Kind, Verdict, judge
from tuner.missions.job import Trial
from tuner.problem.baselines import ANSWERS, PAPER_STRATEGIES, in_table_order
from tuner.problem.goal import Goal
from tuner.problem.objective import Objective

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
