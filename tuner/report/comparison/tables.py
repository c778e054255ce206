"""Comparison tables in the layout of the paper's Table I: cells, markdown, terminal."""

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

# Of the terminal's columns: "– the rocks’ own floor (mm)" and "410.8 ± 115.8" with their borders.
_METRIC_WIDTH, _STRATEGY_WIDTH = 30, 16
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
class DifferenceCell:
    """One strategy against the reference in one metric, ready to print."""

    difference: str  # "+1.2"
    interval: str  # "−0.3 to +2.7"
    verdict: str  # better, worse, no difference detected; "no interval" where there is none
    pairs: str  # "12"
    record: str  # wins–ties–losses
    p_rocks: str  # sign test over rock means
    p_pairs: str  # Wilcoxon over pairs


@dataclass(frozen=True)
class Cell:
    """One strategy's value of one metric, ready to print."""

    text: str  # "71.2 ± 3.1"
    best: bool = False
    paper: str = ""  # the paper's own value; empty if it has none
    difference: DifferenceCell | None = None


@dataclass(frozen=True)
class Line:
    """One line of a table, the same on page and terminal and in markdown; a heading has no cells."""

    name: str
    cells: tuple[Cell, ...] = ()


def table_lines(table: ComparisonTable, *, paper: bool = False) -> list[Line]:
    """The lines of a table; rows that no mission has a value of are left out.

    Parameters
    ----------
    table
        From ``tuner.evaluation.comparison_table``.
    paper
        With the paper's own values.
    """
    lines: list[Line] = []
    group = ""
    for row in measured(table.rows):
        if row.metric.group != group:
            group = row.metric.group
            lines += [Line(group)] if group else []
        cells = [cell(row, name) for name in table.strategies]
        lines.append(
            Line(row_name(row.metric), tuple(cells if paper else (replace(c, paper="") for c in cells)))
        )
        if row.floor is not None:
            floor = Cell(format_number(row.floor, row.metric.decimals))
            lines.append(Line(f"– the rocks’ own floor ({row.metric.unit})", (floor,) * len(cells)))
    return lines


def interval_text(interval: Interval | None, decimals: int) -> str:
    """``71.2 ± 3.1``; bounds are written out where they are not symmetric; a dash without a mission."""
    if interval is None:
        return MISSING
    mean = format_number(interval.mean, decimals)
    if interval.low is None or interval.high is None or interval.low == interval.high:
        return mean  # a count that every mission shares has no width
    if interval.method in ("bootstrap", "wilson"):
        return f"{mean} [{format_number(interval.low, decimals)}, {format_number(interval.high, decimals)}]"
    return f"{mean} ± {format_number((interval.high - interval.low) / 2, decimals)}"


def cell(row: ComparisonRow, strategy: str) -> Cell:
    """The cell of ``strategy`` in ``row``; "best" needs somebody to be better than."""
    metric, known = row.metric, sum(value is not None for value in row.cells.values())
    paper = PAPER_TABLE_I.get(strategy, {}).get(metric.key)
    return Cell(
        interval_text(row.cells[strategy], metric.decimals),
        strategy in row.best and known > len(row.best),
        "" if paper is None else format_number(paper, metric.decimals),
        difference_cell(row, strategy),
    )


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


def full_row_name(metric: MetricRow) -> str:
    """The same with its threshold, for tables without group lines: ``F-score @ 48 mm ↑ (%)``."""
    threshold = metric.group.partition("@")[2].strip()
    return row_name(replace(metric, label=f"{metric.label} @ {threshold}")) if threshold else row_name(metric)


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


def difference_cell(row: ComparisonRow, strategy: str) -> DifferenceCell | None:
    """The strategy against the reference; None for the reference itself and where no pair is common."""
    d, decimals = row.differences.get(strategy), row.metric.decimals
    if d is None:
        return None
    i = d.interval
    bounds = MISSING
    if i.low is not None and i.high is not None and i.low != i.high:
        bounds = (
            f"{format_number(i.low, decimals, signed=True)} to {format_number(i.high, decimals, signed=True)}"
        )
    return DifferenceCell(
        format_number(i.mean, decimals, signed=True),
        bounds,
        difference_verdict(d, row.metric),
        str(d.pairs),
        f"{d.wins}–{d.ties}–{d.losses}",
        p_text(d.sign_p),
        p_text(d.wilcoxon_p),
    )


def p_text(p: float | None) -> str:
    """A p-value with two or three decimals."""
    if p is None:
        return MISSING
    return "< 0.001" if p < 0.001 else f"{p:.3f}" if p < 0.1 else f"{p:.2f}"


def methods_sentence(tables: Sequence[ComparisonTable], place: str = "rock") -> str:
    """How the intervals were made."""
    found = {c.method for t in tables for row in t.rows for c in row.cells.values() if c is not None}
    found |= {
        d.interval.method for t in tables for row in t.rows for d in row.differences.values() if d is not None
    }
    return interval_methods(found).replace("rock", place)


def measured(rows: Sequence[ComparisonRow]) -> list[ComparisonRow]:
    """Those that a mission has a value of: geometric ones have no distances."""
    return [row for row in rows if any(cell is not None for cell in row.cells.values())]


def comparison_markdown(table: ComparisonTable, *, paper: bool = False) -> str:
    """The table as GitHub-flavoured markdown, with the paired differences in the cells.

    Parameters
    ----------
    table
        From ``tuner.evaluation.comparison_table``.
    paper
        With the paper's own values.
    """
    lines = [
        "| Metric | " + " | ".join(map(strategy_label, table.strategies)) + " |",
        "|---|" + "---:|" * len(table.strategies),
    ]
    for line in table_lines(table, paper=paper):
        texts = []
        for c in line.cells:
            text = f"**{c.text}**" if c.best else c.text
            text += f"; paper {c.paper}" if c.paper else ""
            if c.difference is not None:
                interval = "" if c.difference.interval == MISSING else f" [{c.difference.interval}]"
                text += f" ({c.difference.difference}{interval})"
            texts.append(text)
        lines.append(f"| {line.name} | " + " | ".join(texts or [""] * len(table.strategies)) + " |")
    lines.append("| missions | " + " | ".join(missions_text(table, name) for name in table.strategies) + " |")
    lines += ["", f"Mean over rocks ± 95 % interval; best mean in bold. {methods_sentence([table])}"]
    if table.reference is not None and len(table.strategies) > 1:
        lines.append(
            f"In brackets: paired difference from {strategy_label(table.reference)} [95 % interval]."
        )
    if any(row.floor is not None for row in table.rows):
        lines += ["", FLOOR_NOTE]
    return "\n".join([*lines, "", PAPER_NOT_COMPARABLE] if paper else lines) + "\n"


def missions_text(table: ComparisonTable, strategy: str) -> str:
    """``11 + 1 failed``."""
    failed = table.failures[strategy]
    return f"{table.missions[strategy]}" + (f" + {failed} failed" if failed else "")


def terminal_tables(
    table: ComparisonTable,
    width: int,
    *,
    title: str = "Dense cloud against ground truth",
    paper: bool = False,
) -> list[Table]:
    """The table for a terminal of ``width`` columns: several below one another where there are many strategies.

    Parameters
    ----------
    table
        From ``tuner.evaluation.comparison_table``.
    width
        Columns of the terminal.
    title
        Of the first.
    paper
        With the paper's own values, below ours.
    """
    together = max(1, (width - _METRIC_WIDTH) // _STRATEGY_WIDTH)
    out = []
    for start in range(0, len(table.strategies), together):
        block = slice(start, start + together)
        part = Table(title=None if start else title)
        part.add_column("metric", no_wrap=True)
        for name in table.strategies[block]:
            part.add_column(strategy_label(name), justify="right")
        for line in table_lines(table, paper=paper):
            if not line.cells:
                part.add_section()
            texts = []
            for c in line.cells[block]:
                text = f"[bold]{c.text}[/]" if c.best else c.text
                texts.append(f"{text}\n[dim]paper {c.paper}[/]" if c.paper else text)
            part.add_row(line.name if line.cells else f"[italic]{line.name}[/]", *texts)
        part.add_section()
        part.add_row("missions", *(missions_text(table, name) for name in table.strategies[block]))
        out.append(part)
    out[-1].caption = "mean ± 95 % interval; best mean in bold"
    return out
