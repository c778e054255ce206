"""Comparison tables in the layout of the paper's Table I: cells, markdown, terminal."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from rich.console import Console, ConsoleOptions, RenderResult
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
class Cell:
    """One strategy's value of one metric, ready to print."""

    text: str  # "71.2 ± 3.1"
    best: bool
    paper: str  # the paper's own value; empty if it has none


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


def floor_name(row: ComparisonRow) -> str:
    """The line below a score that cannot reach zero."""
    return f"– the rocks’ own floor ({row.metric.unit})"


def floor_text(row: ComparisonRow) -> str:
    """What a perfect reconstruction of everything observable would get."""
    return format_number(row.floor, row.metric.decimals)


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


def _groups(table: ComparisonTable) -> list[tuple[str, list[ComparisonRow]]]:
    groups: dict[str, list[ComparisonRow]] = {}
    for row in measured(table.rows):
        groups.setdefault(row.metric.group, []).append(row)
    return list(groups.items())


def comparison_markdown(table: ComparisonTable, *, paper: bool = False, differences: bool = True) -> str:
    """The table as GitHub-flavoured markdown, to paste into a document.

    Parameters
    ----------
    table
        From ``tuner.evaluation.comparison_table``.
    paper
        Add the paper's own column beside each of its strategies.
    differences
        Add the paired differences against the table's reference.
    """
    columns: list[tuple[str, str, bool]] = []  # heading, strategy, the paper's?
    for name in table.strategies:
        columns.append((strategy_label(name), name, False))
        if paper and name in PAPER_TABLE_I:
            columns.append((f"{strategy_label(name)}, paper", name, True))
    lines = [
        "| Metric | " + " | ".join(heading for heading, _, _ in columns) + " |",
        "|---|" + "---:|" * len(columns),
    ]
    for group, rows in _groups(table):
        if group:
            lines.append(f"| *{group}* |" + " |" * len(columns))
        for row in rows:
            texts = []
            for _, name, from_paper in columns:
                value = cell(row, name)
                texts.append(
                    (value.paper or MISSING)
                    if from_paper
                    else f"**{value.text}**"
                    if value.best
                    else value.text
                )
            lines.append(f"| {row_name(row.metric)} | " + " | ".join(texts) + " |")
            if row.floor is not None:
                own = [MISSING if from_paper else floor_text(row) for _, _, from_paper in columns]
                lines.append(f"| {floor_name(row)} | " + " | ".join(own) + " |")
    counts = [
        ""
        if from_paper
        else f"{table.missions[name]}" + (f" + {table.failures[name]} failed" if table.failures[name] else "")
        for _, name, from_paper in columns
    ]
    lines.append("| missions | " + " | ".join(counts) + " |")
    lines += ["", f"Mean over rocks ± 95 % interval; best mean in bold. {methods_sentence([table])}"]
    if any(row.floor is not None for row in table.rows):
        lines += ["", FLOOR_NOTE]
    if paper:
        lines += ["", PAPER_NOT_COMPARABLE]
    if differences and table.reference is not None:
        lines += ["", *_difference_markdown(table)]
    return "\n".join(lines) + "\n"


def _difference_markdown(table: ComparisonTable) -> list[str]:
    assert table.reference is not None
    others = [name for name in table.strategies if name != table.reference]
    if not others:
        return []
    lines = [
        f"Paired differences against {strategy_label(table.reference)} [95 % interval], p of the sign test over rocks:",
        "",
        "| Metric | " + " | ".join(strategy_label(name) for name in others) + " |",
        "|---|" + "---:|" * len(others),
    ]
    for row in table.rows:
        texts = []
        for name in others:
            d = difference_cell(row, name)
            texts.append(MISSING if d is None else f"{d.difference} [{d.interval}], p {_equals(d.p_rocks)}")
        lines.append(f"| {full_row_name(row.metric)} | " + " | ".join(texts) + " |")
    return lines


def _equals(p: str) -> str:
    return p if p.startswith("<") else f"= {p}"


@dataclass(frozen=True)
class InBlocks:
    """A table for the terminal with a column per strategy, as several below one another where it is too wide.

    ``build`` makes the table of some of the strategies.
    """

    strategies: Sequence[str]
    title: str
    caption: str
    build: Callable[[Sequence[str]], Table]

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        together = max(1, (options.max_width - _METRIC_WIDTH) // _STRATEGY_WIDTH)
        for start in range(0, len(self.strategies), together):
            block = self.build(self.strategies[start : start + together])
            block.title = self.title if start == 0 else None
            block.caption = self.caption if start + together >= len(self.strategies) else None
            yield block


def comparison_terminal_table(
    table: ComparisonTable, *, title: str = "Dense cloud against ground truth", paper: bool = False
) -> InBlocks:
    """The table for the terminal; the paper's own value stands below ours."""

    def build(strategies: Sequence[str]) -> Table:
        out = _terminal_table(strategies)
        for group, rows in _groups(table):
            if group:
                out.add_row(f"[italic]{group}[/]", *([""] * len(strategies)))
            for row in rows:
                texts = []
                for name in strategies:
                    value = cell(row, name)
                    text = f"[bold]{value.text}[/]" if value.best else value.text
                    texts.append(f"{text}\n[dim]paper {value.paper}[/]" if paper and value.paper else text)
                out.add_row(row_name(row.metric), *texts)
                if row.floor is not None:
                    own = [f"[dim]{floor_text(row)}[/]"] * len(strategies)
                    out.add_row(f"[dim]{floor_name(row)}[/]", *own)
            out.add_section()
        counts = []
        for name in strategies:
            failed = f" [red]+ {table.failures[name]} failed[/]" if table.failures[name] else ""
            counts.append(f"{table.missions[name]}{failed}")
        out.add_row("missions", *counts)
        return out

    return InBlocks(table.strategies, title, "mean ± 95 % interval; best mean in bold", build)


def _terminal_table(strategies: Sequence[str]) -> Table:
    out = Table()
    out.add_column("metric", no_wrap=True)
    for name in strategies:
        out.add_column(strategy_label(name), justify="right")
    return out
