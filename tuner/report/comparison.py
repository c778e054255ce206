"""The result of one comparison in sentences and tables: on terminal, page and as JSON."""

from __future__ import annotations

import dataclasses
from functools import cached_property
from pathlib import Path
from typing import Any

from tuner.answer.answer import AnswerTable, StrategyRow, table_of
from tuner.answer.evidence import Evidence
from tuner.comparison.of_campaign import PlannedComparison
from tuner.comparison.plan import EvaluationPlan, EvaluationRun
from tuner.comparison.statistics import (
    PAPER_TABLE_I,
    TABLE_I_ROWS,
    TABLE_I_ROWS_OBSERVABLE,
    ComparisonRow,
    ComparisonTable,
    Verdict,
    comparison_table,
    kind_of,
)
from tuner.missions.registry import kind_on, mission_kind
from tuner.problem.baselines import ANSWERS, PAPER_STRATEGIES, in_table_order
from tuner.problem.baselines import label as strategy_label
from tuner.report import words
from tuner.report.labels import (
    Cell,
    Row,
    Table,
    counted,
    difference_text,
    format_number,
    gain_words,
    measure_text,
    metric_label,
    short_names,
)
from tuner.report.pages import recorded, recorded_rows, write_tables

REPORT_FILE = "report.html"
_TITLES = {
    "whole": "Table I on the whole surface, including the underside, as in the paper",
    "observable": "Table I on the surface that at least two reachable cameras can see",
}
FLOOR_NOTE = (
    "The rocks’ own floor is the value of a perfect reconstruction: surface that no reachable camera sees, or that is removed "
    "with the ground, has a distance to every cloud."
)


class ComparisonFacts:
    """What one comparison found: its strategies under each condition, and the paper's Table I."""

    def __init__(self, planned: PlannedComparison, run: EvaluationRun) -> None:
        self.planned, self.run, self.plan = planned, run, run.plan
        self.reference, self.metric = planned.reference, planned.goal.shown.metric

    @property
    def evidence(self) -> Evidence:
        source = self.planned.source
        seen = frozenset() if source is None else frozenset(source.rocks_seen())
        return Evidence(self.plan.strategies, self.run.records, seen, self.planned.goal.shown)

    @cached_property
    def results(self) -> dict[str, AnswerTable]:
        """The strategies over all conditions, the first, and under each where there are several."""
        names = [condition.name for condition in self.plan.conditions]
        number = self.plan.strategies[self.reference].photographs
        parts = {"Results by strategy": self.evidence}
        for name in names if len(names) > 1 else ():
            records = [r for r in self.run.records if r.condition == name]
            parts[f"Under {name}"] = dataclasses.replace(self.evidence, records=records)
        held_out = not set(self.plan.rocks) & self.evidence.tuned_on
        return {title: table_of(part, held_out, self.reference, number) for title, part in parts.items()}

    @cached_property
    def tables(self) -> dict[str, ComparisonTable]:
        """Table I by surface; empty where no mission has those metrics."""
        records, strategies = self.run.records, in_table_order(self.plan.strategies)
        rows = {"whole": TABLE_I_ROWS, "observable": TABLE_I_ROWS_OBSERVABLE}
        return {
            surface: comparison_table(records, strategies, self.reference, of)
            for surface, of in rows.items()
            if any("whole" in r.metrics for r in records)
        }

    @property
    def judged(self) -> list[StrategyRow]:
        """The tuned strategies, without one the paper's, and else the first, that are not the reference."""
        rows = [row for row in next(iter(self.results.values())).rows if row.strategy != self.reference]
        tuned = [row for row in rows if row.strategy in ANSWERS]
        return tuned or [row for row in rows if row.strategy in PAPER_STRATEGIES] or rows[:1]


# -- sentences ---------------------------------------------------------------------------------------------------


def paper_note(fidelity: str) -> str:
    """Why the paper's numbers do not compare with those of missions of this fidelity."""
    differs = "Renderer, light, flight, mesh resolution and dense stage differ here"
    if mission_kind(fidelity).predicts:
        differs = "Here nothing was photographed or reconstructed: completeness is predicted and accuracy is assumed to be 100 %"
    return (
        "The paper’s numbers are single missions on Apollo 15016 (Gazebo, PX4, COLMAP’s dense reconstruction on a GPU), "
        "without intervals and, by the public code, after deleting every point farther than 50 mm from the ground truth. "
        f"{differs}, so absolute values do not compare; only the order of the strategies "
        "and the sign of their differences can be compared with the paper."
    )


def verdict_text(row: StrategyRow, reference: str, metric: str) -> str:
    """Whether a strategy is better than the reference, with the paired difference and its interval."""
    label, gain, kind = metric_label(metric), row.from_reference, kind_of(row.from_reference)
    whom = strategy_label(reference)
    if row.same_as == reference:
        return f"{row.label} took the same photographs as {whom} in every mission."
    if gain is None:
        return f"{row.label}: no mission in common with {whom}."
    begin = {
        Verdict.BETTER: f"{row.label} is better than {whom}",
        Verdict.WORSE: f"{row.label} is worse than {whom}",
        Verdict.NO_DIFFERENCE: f"No difference detected between {row.label} and {whom}",
        Verdict.NO_INTERVAL: f"{row.label} against {whom}",
    }[kind]
    bounds = "too few missions for an interval"
    if gain.low is not None:
        brackets = difference_text(gain).partition(" ")[2]
        bounds = f"95 % interval {brackets}" if brackets else "the same in every mission"
    where = f"{counted(gain.missions, 'paired mission')} on {counted(gain.rocks, 'target')}"
    if gain.method == "replicates":  # such an interval has no spread between rocks
        where += f", valid for {'this one' if gain.rocks == 1 else 'these'} only"
    return f"{begin} in {label.full}: {gain_words(gain.mean, label.difference_unit)} ({bounds}; {where})."


def verdict_lines(facts: ComparisonFacts) -> list[str]:
    return [verdict_text(row, facts.reference, facts.metric) for row in facts.judged]


def warnings_of(facts: ComparisonFacts) -> list[str]:
    out, run, plan = list[str](), facts.run, facts.plan
    if not run.complete:
        every = len(plan.strategies) * len(plan.instances) * plan.replicates
        finished = f"{len(run.records)} of {every} missions are finished"
        out.append(f"Not complete: {finished}; repeat the command to continue.")
    if run.failures:
        reasons = ", ".join(f"{reason} {n}" for reason, n in run.failures.items())
        out.append(
            f"Failed missions count as 0 in percentages and are left out of the other means ({reasons})."
        )
    if len(plan.rocks) < 3:
        out.append(f"Only {counted(len(plan.rocks), 'rock')}: no result here carries over to other rocks.")
    return out


def _measure(facts: ComparisonFacts) -> str:
    plan = facts.plan
    names = [c.name for c in plan.conditions]
    measure = measure_text(metric_label(facts.metric).full, plan.fidelity, plan.rocks, names)
    return f"{measure}; {counted(len(plan.rocks), 'rock')}."


def evaluation_document(facts: ComparisonFacts) -> dict[str, Any]:
    """For JSON: means, intervals and differences (strategy minus reference) in the metrics' units."""
    return {
        "complete": facts.run.complete,
        "rocks": facts.plan.rocks,
        "replicates": facts.plan.replicates,
        "reference": facts.reference,
        "measure": _measure(facts),
        "notes": facts.planned.notes,
        "verdicts": verdict_lines(facts),
        "warnings": warnings_of(facts),
        "failures": facts.run.failures,
        "results": facts.results,
        "tables": facts.tables,
    }


# -- tables --------------------------------------------------------------------------------------------------


def result_tables(facts: ComparisonFacts, *, narrow: bool = False) -> list[Table]:
    """The strategies over all conditions and under each; ``narrow``: without costs."""
    return [
        dataclasses.replace(words.table_lines(table, facts.metric, narrow=narrow), title=title)
        for title, table in facts.results.items()
    ]


def table_i(table: ComparisonTable, title: str, *, paper: bool = False, differences: bool = True) -> Table:
    """The layout of Table I, with the paper's own values where asked; rows that no mission has a value of are left out."""
    rows: list[Row] = []
    group = ""
    for row in table.rows:
        if all(value is None for value in row.cells.values()):  # geometric missions have no distances
            continue
        if row.metric.group != group:
            group = row.metric.group
            rows.append(Row(group))
        cells = (cell(row, n, paper=paper, difference=differences) for n in table.strategies)
        arrow = "↑" if row.metric.higher_is_better else "↓"
        rows.append(Row(f"{row.metric.label} {arrow} ({row.metric.unit})", tuple(cells)))
        if row.floor is not None:
            floor = (Cell(format_number(row.floor)),) * len(table.strategies)
            rows.append(Row(f"– the rocks’ own floor ({row.metric.unit})", floor))
    missions = [
        f"{table.missions[n]}" + (f" + {table.failures[n]} failed" if table.failures[n] else "")
        for n in table.strategies
    ]
    rows.append(Row("missions", tuple(map(Cell, missions))))
    return Table(title, ("metric", *map(strategy_label, table.strategies)), rows)


def cell(row: ComparisonRow, strategy: str, *, paper: bool = False, difference: bool = True) -> Cell:
    """The cell of ``strategy`` in ``row``, marked as best unless all strategies are equal; below it the interval and the rest."""
    measured = sum(value is not None for value in row.cells.values())
    theirs = PAPER_TABLE_I.get(strategy, {}).get(row.metric.key) if paper else None
    d = row.differences.get(strategy) if difference else None
    mean, *bounds = difference_text(row.cells[strategy], signed=False).split(" ", 1)
    below = bounds + ([] if theirs is None else [f"paper {format_number(theirs)}"])
    below += [] if d is None else [difference_text(d)]
    return Cell(mean, strategy in row.best and measured > len(row.best), tuple(below))


# -- the page ------------------------------------------------------------------------------------------------


def write_comparison_report(facts: ComparisonFacts, command: str = "") -> Path:
    """Write ``report.html`` into the evaluation's directory; returns its path.

    Without a campaign the paper's Table I is beside the measured one, with what is not comparable.

    Raises `UserError`: the directory cannot be written.
    """
    run, plan, paper = facts.run, facts.plan, facts.planned.source is None
    kinds = [kind_of(row.from_reference) for row in facts.judged]
    rows = [row for table in facts.tables.values() for row in table.rows]
    strategies = f"{len(plan.strategies)} strategies"
    if paper:
        of_paper = sum(name in PAPER_STRATEGIES for name in plan.strategies)
        strategies = f"{of_paper} of the paper's {len(PAPER_STRATEGIES)} strategies"
        if of_paper < len(plan.strategies):
            strategies += f" and {counted(len(plan.strategies) - of_paper, 'reference')}"
    truth = " or ".join(sorted({kind_on(rock, plan.fidelity).truth for rock in plan.rocks} - {""}))
    against = f", by dense clouds against {truth}" if truth else ""
    by_target = [words.by_target(facts.evidence, facts.metric)] if len(plan.rocks) > 1 else []
    return write_tables(
        run.directory / REPORT_FILE,
        facts.planned.title,
        f"{strategies} were compared{against}. Differences are from {strategy_label(facts.reference)}.",
        lines=[*verdict_lines(facts), *facts.planned.notes],
        kind="worse" if Verdict.WORSE in kinds else "better" if kinds[:1] == [Verdict.BETTER] else "",
        measure=_measure(facts),
        notes=[*warnings_of(facts), *([paper_note(plan.fidelity)] if paper else [])],
        tables=[*result_tables(facts), *by_target],
        legend=[words.legend(facts.results.values())],
        folded=[
            table_i(table, _TITLES[name], paper=paper and name == "whole")
            for name, table in facts.tables.items()
        ],
        open=paper,
        folded_legend=FLOOR_NOTE if any(row.floor is not None for row in rows) else "",
        provenance=_provenance(plan, run),
        command=command,
    )


def _provenance(plan: EvaluationPlan, run: EvaluationRun) -> list[tuple[str, str]]:
    """Rocks, conditions, versions and revisions."""
    first, last = plan.first_replicate, plan.first_replicate + plan.replicates - 1
    return [
        ("rocks", ", ".join(short_names(plan.rocks))),
        ("conditions", ", ".join(condition.name for condition in plan.conditions)),
        ("replicates", f"{first} to {last}" if last > first else str(first)),
        ("mission preset", ", ".join(sorted({config.preset for config in plan.strategies.values()}))),
        *recorded_rows(recorded([r.record.directory for r in run.records])),
    ]
