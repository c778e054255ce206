"""The result of a comparison in words and tables: of one evaluation, of all results of a campaign; on terminal, page and as JSON."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from typing import Any

import numpy as np

from tuner.comparison.plan import EvaluationPlan, EvaluationRun
from tuner.comparison.statistics import (
    PAPER_TABLE_I,
    ComparisonFacts,
    ComparisonRow,
    ComparisonTable,
    Kind,
    MetricRow,
    Verdict,
)
from tuner.missions.registry import kind_on, mission_kind
from tuner.problem.baselines import (
    ANSWERS,
    PAPER_STRATEGIES,
    description,
    kind_of,
    sees_ground_truth,
)
from tuner.problem.baselines import label as strategy_label
from tuner.report.labels import (
    Cell,
    Row,
    Table,
    counted,
    decimals_for,
    difference_text,
    format_number,
    gain_words,
    interval_methods,
    measure_text,
    metric_label,
    short_names,
)
from tuner.report.pages import recorded, recorded_rows, write_tables

REPORT_FILE = "report.html"
LEGEND = (
    "F is the F-score and C the completeness (%) at 48 and 80 mm, C2C the mean distance from the surface to the cloud (mm), "
    "flight in s; all are of the observable surface. The last column is the paired difference, with its 95 % interval."
)
_TITLES = {
    "whole": "Table I on the whole surface, including the underside, as in the paper",
    "observable": "Table I on the surface that at least two reachable cameras can see",
}
FLOOR_NOTE = (
    "The rocks’ own floor is the value of a perfect reconstruction: surface that no reachable camera sees, or that is removed "
    "with the ground, has a distance to every cloud."
)


def legend_of(table: ComparisonTable) -> str:
    """What the columns are; empty where missions are not of rocks, and each column has its full name."""
    return LEGEND if any(row.metric.label for row in table.rows) else ""


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


def strategies_text(names: Collection[str]) -> str:
    """``the paper's 4 strategies and 2 references``."""
    of_paper = sum(name in PAPER_STRATEGIES for name in names)
    more = f" and {counted(len(names) - of_paper, 'reference')}" if of_paper < len(names) else ""
    return f"{of_paper} of the paper's {len(PAPER_STRATEGIES)} strategies{more}"


# -- sentences ---------------------------------------------------------------------------------------------------


def verdict_text(verdict: Verdict) -> str:
    label, gain = metric_label(verdict.metric), verdict.gain
    who, whom = strategy_label(verdict.strategy), strategy_label(verdict.reference)
    if verdict.kind is Kind.SAME:
        return f"{who} took the same photographs as {whom} in every mission."
    if gain is None:
        return f"{who}: no mission in common with {whom}."
    begin = {
        Kind.BETTER: f"{who} is better than {whom}",
        Kind.WORSE: f"{who} is worse than {whom}",
        Kind.NO_DIFFERENCE: f"No difference detected between {who} and {whom}",
        Kind.NO_INTERVAL: f"{who} against {whom}",
    }[verdict.kind]
    bounds = "too few missions for an interval"
    if gain.low is not None:
        brackets = difference_text(gain).partition(" ")[2]
        bounds = f"95 % interval {brackets}" if brackets else "the same in every mission"
    where = f"{counted(gain.missions, 'paired mission')} on {counted(gain.rocks, 'target')}"
    if gain.method == "replicates":  # such an interval has no spread between rocks
        where += f", valid for {'this one' if gain.rocks == 1 else 'these'} only"
    return f"{begin} in {label.full}: {gain_words(gain.mean, label.difference_unit)} ({bounds}; {where})."


def verdict_lines(facts: ComparisonFacts) -> list[str]:
    """Who is better, metric by metric."""
    return [verdict_text(verdict) for verdict in facts.verdicts]


def measure_of(facts: ComparisonFacts) -> str:
    plan = facts.plan
    names = [c.name for c in plan.conditions]
    measure = measure_text(metric_label(facts.goal.shown.metric).full, plan.fidelity, plan.rocks, names)
    return f"{measure}; {counted(len(plan.rocks), 'rock')}."


def warnings_of(facts: ComparisonFacts) -> list[str]:
    out, run, plan = list[str](), facts.run, facts.plan
    if not run.complete:
        finished = f"{len(run.records)} of {plan.combinations} missions are finished"
        out.append(f"Not complete: {finished}; repeat the command to continue.")
    failed = facts.summary.failures
    if run.failures:
        listed = ", ".join(f"{strategy_label(n)} {failed[n]}" for n in plan.strategies if failed[n])
        reasons = ", ".join(f"{reason} {n}" for reason, n in run.failures.items())
        out.append(
            f"Failed missions count as 0 in percentages and are left out of the other means ({listed}; reasons: {reasons})."
        )
    if len(plan.rocks) < 3:
        out.append(f"Only {counted(len(plan.rocks), 'rock')}: no result here carries over to other rocks.")
    return out


def evaluation_document(facts: ComparisonFacts) -> dict[str, Any]:
    """For JSON: means, intervals and differences (strategy minus reference) in the metrics' units."""
    verdicts = zip(facts.verdicts, verdict_lines(facts))
    return {
        "complete": facts.run.complete,
        "rocks": facts.plan.rocks,
        "replicates": facts.plan.replicates,
        "reference": facts.reference,
        "measure": measure_of(facts),
        "notes": facts.planned.notes,
        "verdicts": [{"text": text, **vars(verdict)} for verdict, text in verdicts],
        "warnings": warnings_of(facts),
        "failures": facts.run.failures,
        "summary": facts.summary,
        "conditions": facts.conditions,
        "tables": facts.tables,
    }


# -- tables --------------------------------------------------------------------------------------------------


def strategy_table(
    table: ComparisonTable, title: str, quality: str, run: EvaluationRun | None = None
) -> Table:
    """A row per strategy, 80 columns wide at most: means, and the paired difference of the ``quality`` from the reference.

    With its ``run`` what each strategy does is below its name.
    """
    shown = next((row for row in table.rows if row.metric.key == quality), None)
    rows: list[Row] = []
    kind = ""
    for name in table.strategies:
        if kind_of(name) != kind:
            kind = kind_of(name)
            rows.append(Row(kind))
        texts = [
            format_number(None if (v := row.cells[name]) is None else v.mean, _decimals(row))
            for row in table.rows
        ]
        if shown is not None:
            difference = difference_text(shown.differences.get(name), _decimals(shown))
            texts.append("reference" if name == table.reference else difference)
        note = "" if run is None else _what(name, run)
        rows.append(Row(strategy_label(name), tuple(map(Cell, texts)), note, best=name in ANSWERS))
    notes = [
        f"{strategy_label(name)}: {counted(failed, 'failed mission')}, counted as 0 in percentages."
        for name, failed in table.failures.items()
        if failed
    ]
    notes += [
        f"{strategy_label(name)} took the same photographs as {strategy_label(same)}."
        for name, same in table.same.items()
    ]
    if shown is not None:
        rocks = {name: cell.rocks for name, cell in shown.cells.items() if cell is not None}
        fewer = [strategy_label(name) for name, count in rocks.items() if count < max(rocks.values())]
        if fewer:
            notes.append(f"On fewer of them: {', '.join(fewer)}; compare differences, not means.")
    if oracles := [strategy_label(name) for name in table.strategies if sees_ground_truth(name)]:
        see = "sees" if len(oracles) == 1 else "see"
        notes.append(f"{' and '.join(oracles)} {see} the true surface, which a vehicle does not know.")
    columns = ["strategy", *(_name(row.metric) for row in table.rows)]
    if shown is not None:
        columns.append(f"{_name(shown.metric)} from {strategy_label(table.reference)}")
    return Table(title, tuple(columns), rows, " ".join(notes))


def _name(metric: MetricRow) -> str:
    return metric.label or metric_label(metric.key).axis


def _decimals(row: ComparisonRow) -> int:
    """Those of the metric; without them as many as the spread of its means deserves."""
    if row.metric.decimals is not None:
        return row.metric.decimals
    return decimals_for(
        float(np.std([cell.mean for cell in row.cells.values() if cell is not None] or [0.0]))
    )


def _what(name: str, run: EvaluationRun) -> str:
    owner = run.plan.owners[name]
    same = "" if owner == name else f"the same missions as {strategy_label(owner)}"
    return "; ".join(filter(None, [description(name), same]))


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
            floor = Cell(format_number(row.floor, _decimals(row)))
            rows.append(Row(f"– the rocks’ own floor ({row.metric.unit})", (floor,) * len(table.strategies)))
    missions = [
        f"{table.missions[n]}" + (f" + {table.failures[n]} failed" if table.failures[n] else "")
        for n in table.strategies
    ]
    rows.append(Row("missions", tuple(map(Cell, missions))))
    return Table(title, ("metric", *map(strategy_label, table.strategies)), rows)


def cell(row: ComparisonRow, strategy: str, *, paper: bool = False, difference: bool = True) -> Cell:
    """The cell of ``strategy`` in ``row``, marked as best unless all strategies are equal; below it the interval and the rest."""
    metric, known, digits = row.metric, sum(value is not None for value in row.cells.values()), _decimals(row)
    theirs = PAPER_TABLE_I.get(strategy, {}).get(metric.key) if paper else None
    d = row.differences.get(strategy) if difference else None
    mean, *bounds = difference_text(row.cells[strategy], digits, signed=False).split(" ", 1)
    below = bounds + ([] if theirs is None else [f"paper {format_number(theirs, digits)}"])
    below += [] if d is None else [difference_text(d, digits)]
    return Cell(mean, strategy in row.best and known > len(row.best), tuple(below))


def _table_by_instance(facts: ComparisonFacts) -> Table:
    """The mean of every strategy in every instance, in the quality or the only objective."""
    plan, o = facts.plan, facts.goal.shown
    stems = dict(zip(plan.rocks, short_names(plan.rocks)))
    several = len(plan.conditions) > 1
    names = [f"{stems[w.rock]}, {w.condition}" if several else stems[w.rock] for w in plan.instances]
    rows = []
    for name in plan.strategies:
        records = [r for r in facts.run.records if r.strategy == name]
        by_instance = [
            [r.measured(o) for r in records if r.instance == instance] for instance in plan.instances
        ]
        known = [[value for value in values if value is not None] for values in by_instance]
        means = (format_number(float(np.mean(values)) if values else None) for values in known)
        rows.append([strategy_label(name), *means])
    caption = f"{metric_label(o.metric).full}, mean over replicates."
    title = "Rock by rock"
    return Table.of(title, ("strategy", *names), rows, caption)


# -- the page ------------------------------------------------------------------------------------------------


def write_comparison_report(facts: ComparisonFacts, command: str = "") -> Path:
    """Write ``report.html`` into the evaluation's directory; returns its path.

    Without a campaign the paper's Table I is beside the measured one, with what is not comparable.

    Raises `UserError`: the directory cannot be written.
    """
    run, plan, quality, paper = facts.run, facts.plan, facts.goal.shown.metric, facts.planned.source is None
    kinds = [verdict.kind for verdict in facts.verdicts]
    rows = [row for table in (facts.summary, *facts.tables.values()) for row in table.rows]
    methods = {i.method for row in rows for i in (*row.cells.values(), *row.differences.values()) if i}
    strategies = strategies_text(plan.strategies) if paper else f"{len(plan.strategies)} strategies"
    truth = _truth(plan)
    against = f", by dense clouds against {truth}" if truth else ""
    tables = [strategy_table(facts.summary, "Results by strategy", quality, run)]
    tables += [strategy_table(table, f"Under {name}", quality) for name, table in facts.conditions.items()]
    tables += [_table_by_instance(facts)] if len(plan.instances) > 1 else []
    return write_tables(
        run.directory / REPORT_FILE,
        facts.planned.title,
        f"{strategies} were compared{against}. Differences are from {strategy_label(facts.reference)}.",
        said=[*verdict_lines(facts), *facts.planned.notes],
        kind="worse" if Kind.WORSE in kinds else "better" if kinds[:1] == [Kind.BETTER] else "",
        measure=measure_of(facts),
        notes=[*warnings_of(facts), *([paper_note(plan.fidelity)] if paper else [])],
        tables=tables,
        legend=[*filter(None, [legend_of(facts.summary)]), interval_methods(methods)],
        folded=[
            table_i(table, _TITLES[name], paper=paper and name == "whole")
            for name, table in facts.tables.items()
        ],
        open=paper,
        folded_legend=FLOOR_NOTE if any(row.floor is not None for row in rows) else "",
        provenance=_provenance(run),
        command=command,
    )


def _truth(plan: EvaluationPlan) -> str:
    """What clouds are measured against; empty where it is not known, or there are none."""
    return " or ".join(sorted({kind_on(rock, plan.fidelity).truth for rock in plan.rocks} - {""}))


def _provenance(run: EvaluationRun) -> list[tuple[str, str]]:
    """Rocks, conditions, versions and revisions."""
    plan = run.plan
    first, last = plan.first_replicate, plan.first_replicate + plan.replicates - 1
    return [
        ("rocks", ", ".join(short_names(plan.rocks))),
        ("conditions", ", ".join(condition.name for condition in plan.conditions)),
        ("replicates", f"{first} to {last}" if last > first else str(first)),
        ("mission preset", ", ".join(sorted({config.preset for config in plan.strategies.values()}))),
        *recorded_rows(recorded([r.record.directory for r in run.records])),
    ]
