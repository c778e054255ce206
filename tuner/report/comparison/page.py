"""``report.html`` of ``gatetune evaluate`` and ``gatetune reproduce``: strategies against each other."""

from __future__ import annotations

import collections
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, Literal

from nbv.errors import UserError
from nbv.mission.run_directory import write_atomic
from nbv.provenance import versions
from tuner.evaluation.baselines import TUNED, TUNED_POOL_RANDOM
from tuner.evaluation.baselines import label as strategy_label
from tuner.evaluation.comparison import ComparisonTable, comparison_table
from tuner.evaluation.flying import EvaluationRun
from tuner.evaluation.paper_table import PAPER_TABLE_I, MetricRow
from tuner.evaluation.plan import EvaluationRecord
from tuner.problem.objective import DEFAULT_METRIC
from tuner.report.comparison.figures import forest_figure, rocks_figure
from tuner.report.comparison.rows import provenance_rows, strategy_row
from tuner.report.comparison.tables import (
    FLOOR_NOTE,
    PAPER_NOT_COMPARABLE,
    cell,
    comparison_markdown,
    difference_cell,
    difference_verdict,
    floor_name,
    floor_text,
    full_row_name,
    gain_interval,
    methods_sentence,
    row_name,
)
from tuner.report.comparison.verdicts import LimitAsked, limit_rows, limit_sentences
from tuner.report.labels import format_number, metric_label, with_unit
from tuner.report.pages import write_page
from tuner.report.sectors import sector_figure
from tuner.report.style import Illustration, embed

Surface = Literal["whole", "observable"]
REPORT_FILE = "report.html"
TABLE_FILE = "table.md"
FIGURES_DIRECTORY = "figures"
SECTOR_KEY = "sector_completeness_48mm"


def write_comparison_report(
    run: EvaluationRun,
    directory: Path,
    *,
    title: str = "Strategies compared",
    reference: str | None = None,
    metric: str = DEFAULT_METRIC,
    surfaces: Sequence[Surface] = ("whole", "observable"),
    paper: bool = False,
    command: str = "",
    rows: Sequence[MetricRow] | None = None,
    asked: LimitAsked | None = None,
) -> Path:
    """Write ``report.html``, ``table.md`` and ``figures/*.png`` into ``directory``.

    Parameters
    ----------
    run
        What ``tuner.evaluation.run_evaluation`` returned; may be incomplete.
    reference
        Strategy against which differences are taken. None: ``hyb-h`` where it was evaluated (the paper's default
        configuration), else the first strategy.
    metric
        The metric of the headline and of the rock-by-rock figure.
    surfaces
        One table each; the first one decides the forest plot.
    paper
        Show the paper's Table I beside ours, with what is not comparable.
    command
        The command line that repeats the evaluation.
    rows
        What missions that are not ours are compared in, instead of Table I's rows on ``surfaces``.
    asked
        The limit of the campaign, where it has one: the page leads with whether it is kept.

    Returns
    -------
    Path of the page.

    Raises
    ------
    UserError
        The reference was not evaluated, or the directory cannot be written.
    """
    try:
        facts = comparison_context(
            run,
            directory / FIGURES_DIRECTORY,
            reference=reference,
            metric=metric,
            surfaces=surfaces,
            paper=paper,
            rows=rows,
            asked=asked,
        )
        markdown = "\n".join(
            f"### {part['title']}\n\n{comparison_markdown(part['table'], paper=paper and part['surface'] == 'whole')}"
            for part in facts["tables"]
        )
        write_atomic(directory / TABLE_FILE, markdown)
    except OSError as error:
        raise UserError(f"cannot write to {directory}: {error.strerror}; choose another directory") from error
    return write_page(
        directory / REPORT_FILE,
        "comparison.html.j2",
        title=f"{title} · gatetune",
        heading=title,
        comparison=facts,
        command=command,
        version=versions().get("gatetune", ""),
    )


def comparison_context(
    run: EvaluationRun,
    figures: Path | None = None,
    *,
    reference: str | None = None,
    metric: str = DEFAULT_METRIC,
    surfaces: Sequence[Surface] = ("whole", "observable"),
    paper: bool = False,
    rows: Sequence[MetricRow] | None = None,
    asked: LimitAsked | None = None,
) -> dict[str, Any]:
    """Everything the template ``comparison_body.html.j2`` shows."""
    strategies = in_order(run.plan.strategies)
    if reference is None:
        reference = "hyb-h" if "hyb-h" in strategies else strategies[0]
    if rows is not None:
        surfaces = surfaces[:1]
        tables = [comparison_table(run.records, strategies, reference, None, rows)]
    else:
        tables = [comparison_table(run.records, strategies, reference, surface) for surface in surfaces]
    headline = metric_row(metric) if rows is None else rows[0]
    leading = comparison_table(run.records, strategies, reference, None, (headline,))
    others = [name for name in strategies if name != reference]
    limited = limit_sentences(run.records, reference, asked) if asked is not None else []
    own = [{"kind": "", "text": text} for text in [" ".join(limited)] if text]
    sentences = own or _sentences(leading, others)
    shown = limit_rows(tables[0], run.records, asked)
    return {
        "sentences": sentences,
        "warnings": _warnings(run, tables[0]),
        "measure": _measure(run, headline.key),
        "strategies": [strategy_row(run, name) for name in strategies],
        "reference": strategy_label(reference),
        "ours": rows is None,
        "others": [strategy_label(name) for name in others],
        "tables": [
            {
                "title": f"{surface.capitalize()} surface" if rows is None else "Metrics and costs",
                "note": _SURFACE_NOTES[surface] if rows is None else "",
                "surface": surface,
                "table": table,
                "rows": _table_rows(
                    shown if table is tables[0] else table, strategies, paper and surface == "whole"
                ),
                "differences": [_difference_rows(table, name) for name in others],
            }
            for surface, table in zip(surfaces, tables)
        ],
        "by_condition": [
            _under(run, condition.name, reference, headline) for condition in run.plan.conditions
        ]
        if len(run.plan.conditions) > 1
        else [],
        "headline_name": metric_label(metric).full,
        "methods": methods_sentence([*tables, leading]),
        "comparisons": len(others) * len(tables[0].rows) * len(tables),
        "paper": PAPER_NOT_COMPARABLE if paper else "",
        "floor": FLOOR_NOTE if any(row.floor is not None for t in tables for row in t.rows) else "",
        "figures": _figures(run, tables[0], headline, figures, surfaces[0] if rows is None else None),
        "provenance": provenance_rows(run),
    }


def in_order(strategies: Iterable[str]) -> tuple[str, ...]:
    """As planned, chance in the tuned pool beside chance in the default's."""
    names = list(strategies)
    if TUNED_POOL_RANDOM in names and "random" in names:
        names.remove(TUNED_POOL_RANDOM)
        names.insert(names.index("random") + 1, TUNED_POOL_RANDOM)
    return tuple(names)


def _measure(run: EvaluationRun, metric: str) -> str:
    """Which surface, fidelity and condition the verdict is of."""
    names = [condition.name for condition in run.plan.conditions]
    where = f"{'conditions' if len(names) > 1 else 'condition'} {', '.join(names)}"
    return (
        f"{metric_label(metric).full}; {run.plan.fidelity} missions; {where}; {_rocks(len(run.plan.rocks))}."
    )


def _rocks(count: int) -> str:
    return "1 rock" if count == 1 else f"{count} rocks"


def _under(run: EvaluationRun, condition: str, reference: str, headline: MetricRow) -> dict[str, Any]:
    """The headline metric under one condition: every strategy, and its difference from the reference."""
    strategies = in_order(run.plan.strategies)
    own = [r for r in run.records if r.condition == condition]
    table = comparison_table(own, strategies, reference, None, (headline,))
    row = table.rows[0]
    differences = {name: difference_cell(row, name) for name in strategies}
    return {
        "name": condition,
        "cells": [
            {"text": c.text, "best": c.best, "difference": differences[name]}
            for name in strategies
            for c in [cell(row, name)]
        ],
        "failed": sum(table.failures.values()),
    }


def leading_verdict(
    run: EvaluationRun,
    reference: str | None,
    metric: str,
    rows: Sequence[MetricRow] | None = None,
    asked: LimitAsked | None = None,
) -> str:
    """The sentence that the page leads with; empty where there is nothing to compare."""
    strategies = tuple(run.plan.strategies)
    against = reference or ("hyb-h" if "hyb-h" in strategies else strategies[0])
    if asked is not None and (limited := limit_sentences(run.records, against, asked)):
        return "\n".join(limited)
    row = metric_row(metric) if rows is None else rows[0]
    leading = comparison_table(run.records, strategies, against, None, (row,))
    found = _sentences(leading, [name for name in strategies if name != against])
    return found[0]["text"] if found else ""


_SURFACE_NOTES = {
    "whole": "Against the complete reference surface, underside included, as in the paper.",
    "observable": "Against the part of the reference surface that at least two reachable cameras can see: nobody can win "
    "or lose on the rest.",
}


def metric_row(metric: str) -> MetricRow:
    """A table row for any metric path or ``costs.NAME``."""
    label = metric_label(metric)
    return MetricRow("", label.name, metric, label.unit, label.larger_is_better, 1)


def _sentences(leading: ComparisonTable, others: Sequence[str]) -> list[dict[str, str]]:
    """One honest sentence per strategy against the reference in the headline metric; the tuned one first."""
    assert leading.reference is not None
    row = leading.rows[0]
    out: list[dict[str, str]] = []
    label = metric_label(row.metric.key)
    reference = strategy_label(leading.reference)
    if not others:
        return out
    for name in sorted(others, key=lambda n: n != TUNED):
        d = row.differences[name]
        if d is None:
            out.append(
                {"kind": "", "text": f"{strategy_label(name)}: no mission in common with {reference}."}
            )
            continue
        _, low, high = gain_interval(d, row.metric)
        kind = difference_verdict(d, row.metric)
        bounds = (
            f"95 % interval {format_number(low, 1, signed=True)} to {format_number(high, 1, signed=True)}"
            if low is not None and high is not None
            else "too few missions for an interval"
        )
        gain = with_unit(gain_interval(d, row.metric)[0], label.difference_unit, 1, signed=True)
        how = f"improvement {gain} ({bounds}; {d.pairs} paired missions on {_rocks(d.interval.rocks)})"
        text = {
            "better": f"{strategy_label(name)} is better than {reference} in {label.full}: {how}.",
            "worse": f"{strategy_label(name)} is worse than {reference} in {label.full}: {how}.",
            "no difference detected": f"No difference detected between {strategy_label(name)} and {reference} in {label.full}: {how}.",
            "no interval": f"{strategy_label(name)} against {reference} in {label.full}: {how}.",
        }[kind]
        out.append({"kind": kind.split()[0], "text": text})
    return out


def _warnings(run: EvaluationRun, table: ComparisonTable) -> list[str]:
    out = []
    expected = len(run.plan.strategies) * len(run.plan.worlds) * run.plan.replicates
    if not run.complete:
        out.append(
            f"Not complete: {len(run.records)} of {expected} missions are finished; the same command goes on."
        )
    failed = {strategy_label(name): n for name, n in table.failures.items() if n}
    if failed:
        listed = ", ".join(f"{name} {n}" for name, n in failed.items())
        reasons = ", ".join(f"{reason} {n}" for reason, n in run.failures.items())
        out.append(
            f"Failed missions are left out of all means and differences ({listed}; reasons: {reasons}). "
            "A strategy that fails where others succeed is worse than its means say."
        )
    if len(run.plan.rocks) < 3:
        out.append(f"Only {_rocks(len(run.plan.rocks))}: nothing here speaks for other rocks.")
    return out


def _table_rows(table: ComparisonTable, strategies: Sequence[str], paper: bool) -> list[dict[str, Any]]:
    rows: list[dict[str, Any]] = []
    group = ""
    for row in table.rows:
        if row.metric.group != group:
            group = row.metric.group
            rows.append({"group": group})
        cells = [cell(row, name) for name in strategies]
        rows.append(
            {
                "group": "",
                "name": row_name(row.metric),
                "cells": [{"text": c.text, "best": c.best, "paper": c.paper if paper else ""} for c in cells],
            }
        )
        if row.floor is not None:
            own = {"text": floor_text(row), "best": False, "paper": ""}
            rows.append({"group": "", "name": floor_name(row), "cells": [own] * len(strategies)})
    return rows


def _difference_rows(table: ComparisonTable, name: str) -> dict[str, Any]:
    rows = []
    for row in table.rows:
        rows.append({"name": full_row_name(row.metric), "cell": difference_cell(row, name)})
    return {"strategy": strategy_label(name), "rows": rows}


# -- figures -------------------------------------------------------------------------------------------------


def _figures(
    run: EvaluationRun,
    table: ComparisonTable,
    headline: MetricRow,
    figures: Path | None,
    surface: Surface | None,
) -> list[Illustration]:
    strategies, several = in_order(run.plan.strategies), len(run.plan.conditions) > 1
    out = []
    forest = forest_figure(table)
    if forest is not None:
        assert table.reference is not None
        out.append(
            embed(
                forest,
                "differences",
                f"Forest plots: paired improvement of every strategy over {strategy_label(table.reference)}, one panel per metric.",
                f"Paired improvement over {strategy_label(table.reference)} on common (rock, replicate) pairs with 95 % intervals"
                f"{f', {surface} surface' if surface else ''}; right of zero is better in every panel, whatever the metric’s direction.",
                figures,
                title=f"Differences from {strategy_label(table.reference)}",
            )
        )
    if any(r.value(headline.key) is not None for r in run.records):
        out.append(
            embed(
                rocks_figure(run.records, strategies, run.plan.worlds, headline),
                "rocks",
                f"{headline.label} of every mission, grouped by rock, one colour and marker per strategy.",
                f"{metric_label(headline.key).full} rock by rock{' and condition by condition' if several else ''}: every mission (dots) and each strategy’s mean (bars). "
                "Crosses with a count at the bottom: failed missions.",
                figures,
                title="Rock by rock",
            )
        )
    sectors, centers = _sectors(run.records, strategies, surface)
    if sectors:
        out.append(
            embed(
                sector_figure(sectors, centers),
                "sectors",
                "Polar plot of completeness per azimuth sector, one line per strategy.",
                f"Completeness at 48 mm by azimuth sector of the rock ({surface} surface), mean over missions; 0° is east, "
                "90° north, labels at sector centres (the paper’s Fig. 3).",
                figures,
                title="Sector by sector",
            )
        )
    return out


def _sectors(
    records: Sequence[EvaluationRecord], strategies: Sequence[str], surface: Surface | None
) -> tuple[dict[str, list[list[float | None]]], list[float]]:
    found: dict[str, list[list[float | None]]] = collections.defaultdict(list)
    centers: list[float] = []
    for name in strategies:
        for r in records:
            metrics = r.outcome.metrics
            values = metrics.get(surface, {}).get(SECTOR_KEY) if surface else None
            here = metrics.get("sector_centers_deg")
            if r.strategy == name and r.outcome.status != "failed" and values and here:
                centers = centers or list(here)
                if list(here) == centers:
                    found[strategy_label(name)].append(values)
    return dict(found), centers


__all__ = [
    "PAPER_TABLE_I",
    "comparison_context",
    "comparison_markdown",
    "leading_verdict",
    "write_comparison_report",
]
