"""Comparison tables: a row per strategy, or in the layout of the paper's Table I; for page, markdown and terminal."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from rich.table import Table

from tuner.evaluation.baselines import label as strategy_label
from tuner.evaluation.comparison import ComparisonRow, ComparisonTable
from tuner.evaluation.paper_table import PAPER_TABLE_I, MetricRow
from tuner.evaluation.statistics import Interval, PairedDifference
from tuner.missions.job import Trial
from tuner.problem.objective import Objective
from tuner.report.labels import (
    MISSING,
    decimals_for,
    format_number,
    interval_methods,
    metric_label,
    verdict,
)

FLOOR_NOTE = (
    "The rocks’ own floor is what a reconstruction without error or omission would get: surface that no reachable camera "
    "sees, and what is cut away with the ground, keep a distance from every cloud."
)

PAPER_NOT_COMPARABLE = (
    "The paper’s numbers are single missions on Apollo 15016 (Gazebo, PX4, COLMAP’s dense reconstruction on a GPU), without "
    "intervals and, by the public code, after deleting every point farther than 50 mm from the ground truth. Renderer, light, "
    "flight, mesh resolution and dense stage differ here, so absolute values do not compare; what can be held against the "
    "paper is the order of the strategies and the sign of their differences."
)


@dataclass(frozen=True)
class Cell:
    """One strategy's value of one metric, ready to print."""

    text: str  # "71.2 ± 3.1"
    best: bool = False
    paper: str = ""  # the paper's own value; empty if it has none
    difference: str = ""  # from the reference, "+1.2 (−0.3 to +2.7)"


@dataclass(frozen=True)
class Line:
    """One line of Table I; a heading has no cells."""

    name: str
    cells: tuple[Cell, ...] = ()


def table_lines(table: ComparisonTable, *, paper: bool = False) -> list[Line]:
    """The lines of Table I, with the paper's own values where asked; rows that no mission has a value of are left out."""
    lines: list[Line] = []
    group = ""
    for row in table.rows:
        if all(value is None for value in row.cells.values()):  # geometric missions have no distances
            continue
        if row.metric.group != group:
            group = row.metric.group
            lines.append(Line(group))
        cells = (cell(row, name) for name in table.strategies)
        lines.append(Line(row_name(row.metric), tuple(c if paper else replace(c, paper="") for c in cells)))
        if row.floor is not None:
            floor = Cell(format_number(row.floor, row.metric.decimals))
            lines.append(
                Line(f"– the rocks’ own floor ({row.metric.unit})", (floor,) * len(table.strategies))
            )
    return lines


def strategy_lines(table: ComparisonTable) -> tuple[list[str], list[Line]]:
    """The names of the columns, and a line per strategy."""
    lines = [Line(name, tuple(cell(row, name) for row in table.rows)) for name in table.strategies]
    return [row_name(row.metric) for row in table.rows], lines


def interval_text(interval: Interval | None, decimals: int) -> str:
    """``71.2 ± 3.1``; bounds are written out where they are not symmetric; a dash without a mission."""
    if interval is None:
        return MISSING
    mean = format_number(interval.mean, decimals)
    if interval.low is None or interval.high is None or interval.low == interval.high:
        return mean  # a count that every mission shares has no width
    if interval.method == "wilson":
        return f"{mean} [{format_number(interval.low, decimals)}, {format_number(interval.high, decimals)}]"
    return f"{mean} ± {format_number((interval.high - interval.low) / 2, decimals)}"


def cell(row: ComparisonRow, strategy: str) -> Cell:
    """The cell of ``strategy`` in ``row``; "best" needs somebody to be better than."""
    metric, known = row.metric, sum(value is not None for value in row.cells.values())
    paper = PAPER_TABLE_I.get(strategy, {}).get(metric.key)
    difference = row.differences.get(strategy)
    return Cell(
        interval_text(row.cells[strategy], metric.decimals),
        strategy in row.best and known > len(row.best),
        "" if paper is None else format_number(paper, metric.decimals),
        "" if difference is None else difference_text(difference, metric.decimals),
    )


def difference_text(d: PairedDifference, decimals: int) -> str:
    """``+1.2 (−0.3 to +2.7)``: strategy minus reference."""
    i, mean = d.interval, format_number(d.interval.mean, decimals, signed=True)
    if i.low is None or i.high is None:
        return mean
    low, high = (format_number(bound, decimals, signed=True) for bound in (i.low, i.high))
    return f"{mean} ({low} to {high})"


def row_name(metric: MetricRow) -> str:
    """``Hausdorff ↓ (mm)``."""
    unit = f" ({metric.unit})" if metric.unit else ""
    return f"{metric.label} {'↑' if metric.higher_is_better else '↓'}{unit}"


def mission_file_rows(objective: Objective, records: Sequence[Trial]) -> tuple[MetricRow, ...]:
    """What missions of a mission file are compared in: its metric and their costs, of which less is better."""
    costs = sorted({name for r in records for name in r.costs})
    keys = {objective.metric: objective.direction == "maximise", **{f"costs.{name}": False for name in costs}}
    rows = []
    for key, more_is_better in keys.items():
        values = [value for r in records if (value := r.value(key)) is not None]
        digits = decimals_for(float(np.std(values))) if values else 1
        label = metric_label(key)
        rows.append(MetricRow("", label.name, key, label.unit, more_is_better, digits))
    return tuple(rows)


def gain_interval(
    difference: PairedDifference, metric: MetricRow
) -> tuple[float, float | None, float | None]:
    """``(gain, low, high)``: the difference oriented so that positive is better than the reference."""
    i = difference.interval
    if metric.higher_is_better:
        return i.mean, i.low, i.high
    return -i.mean, None if i.high is None else -i.high, None if i.low is None else -i.low


def difference_verdict(difference: PairedDifference, metric: MetricRow) -> str:
    """``better``, ``worse``, ``no difference detected``, or ``no interval``."""
    _, low, high = gain_interval(difference, metric)
    return "no interval" if low is None or high is None else verdict((low, high))


def methods_sentence(tables: Sequence[ComparisonTable], place: str = "rock") -> str:
    """How the intervals were made."""
    found = {c.method for t in tables for row in t.rows for c in row.cells.values() if c is not None}
    found |= {
        d.interval.method for t in tables for row in t.rows for d in row.differences.values() if d is not None
    }
    return interval_methods(found).replace("rock", place)


def missions_text(table: ComparisonTable, strategy: str) -> str:
    """``11 + 1 failed``."""
    failed = table.failures[strategy]
    return f"{table.missions[strategy]}" + (f" + {failed} failed" if failed else "")


def strategies_for_terminal(table: ComparisonTable, title: str) -> Table:
    """A row per strategy; the difference from the reference below its value."""
    names, lines = strategy_lines(table)
    out = Table(title=title, caption="mean ± 95 % interval, paired difference below; best mean in bold")
    out.add_column("strategy")
    for name in (*names, "missions"):
        out.add_column(name, justify="right")
    for line in lines:
        texts = [_marked(c, c.difference) for c in line.cells]
        out.add_row(strategy_label(line.name), *texts, missions_text(table, line.name))
    return out


def table_i_for_terminal(table: ComparisonTable, title: str) -> Table:
    """Table I, with the paper's own values below ours."""
    out = Table(title=title, caption="mean ± 95 % interval; best mean in bold")
    out.add_column("metric", no_wrap=True)
    for name in table.strategies:
        out.add_column(strategy_label(name), justify="right")
    for line in table_lines(table, paper=True):
        if not line.cells:
            out.add_section()
        texts = [_marked(c, f"paper {c.paper}" if c.paper else "") for c in line.cells]
        out.add_row(line.name if line.cells else f"[italic]{line.name}[/]", *texts)
    out.add_section()
    out.add_row("missions", *(missions_text(table, name) for name in table.strategies))
    return out


def _marked(c: Cell, below: str) -> str:
    text = f"[bold]{c.text}[/]" if c.best else c.text
    return f"{text}\n[dim]{below}[/]" if below else text
