"""``report.html`` of ``gatetune evaluate``, ``confirm`` and ``reproduce``: strategies against each other."""

from __future__ import annotations

import collections
from pathlib import Path
from typing import Any

from nbv.errors import UserError
from nbv.mission.run_directory import write_atomic
from nbv.provenance import versions
from tuner.evaluation.baselines import label as strategy_label
from tuner.evaluation.comparison import ComparisonTable
from tuner.missions.registry import EXTERNAL
from tuner.report.comparison.facts import ComparisonFacts, Surface
from tuner.report.comparison.figures import rocks_figure
from tuner.report.comparison.rows import provenance_rows, strategy_row
from tuner.report.comparison.tables import (
    FLOOR_NOTE,
    PAPER_NOT_COMPARABLE,
    comparison_markdown,
    difference_cell,
    full_row_name,
    measured,
    methods_sentence,
    table_lines,
)
from tuner.report.labels import metric_label
from tuner.report.pages import write_page
from tuner.report.sectors import sector_figure
from tuner.report.style import Illustration, embed

REPORT_FILE = "report.html"
TABLE_FILE = "table.md"
FIGURES_DIRECTORY = "figures"
SECTOR_KEY = "sector_completeness_48mm"
_SURFACE_NOTES: dict[Surface | None, str] = {
    None: "",
    "whole": "Against the complete reference surface, underside included, as in the paper.",
    "observable": "Against the part of the reference surface that at least two reachable cameras can see: nobody can win "
    "or lose on the rest.",
}


def write_comparison_report(
    facts: ComparisonFacts,
    directory: Path,
    *,
    title: str = "Strategies compared",
    paper: bool = False,
    command: str = "",
) -> Path:
    """Write ``report.html``, ``table.md`` and ``figures/*.png`` into ``directory``.

    Parameters
    ----------
    facts
        From `comparison_facts`; the run may be incomplete. The first table decides the sectors.
    paper
        Show the paper's Table I beside ours, with what is not comparable.
    command
        The command line that repeats the evaluation.

    Returns
    -------
    Path of the page.

    Raises
    ------
    UserError
        The directory cannot be written.
    """
    try:
        context = comparison_context(facts, directory / FIGURES_DIRECTORY, paper=paper)
        markdown = "\n".join(
            f"### {part.title}\n\n{comparison_markdown(part.table, paper=paper and part.surface == 'whole')}"
            for part in facts.parts
        )
        write_atomic(directory / TABLE_FILE, markdown)
    except OSError as error:
        raise UserError(f"cannot write to {directory}: {error.strerror}; choose another directory") from error
    return write_page(
        directory / REPORT_FILE,
        "comparison.html.j2",
        title=f"{title} · gatetune",
        heading=title,
        comparison=context,
        command=command,
        version=versions().get("gatetune", ""),
    )


def comparison_context(
    facts: ComparisonFacts, figures: Path | None = None, *, paper: bool = False
) -> dict[str, Any]:
    """Everything the template ``comparison_body.html.j2`` shows."""
    run, tables = facts.run, [part.table for part in facts.parts]
    others = [name for name in facts.strategies if name != facts.reference]
    short = [] if facts.summary is None else [facts.summary]
    return {
        "facts": facts,
        "kind": _kind([line.kind for line in facts.verdicts]),
        "strategies": [strategy_row(run, name) for name in facts.strategies],
        "reference": strategy_label(facts.reference),
        "ours": run.plan.fidelity != EXTERNAL,
        "summary": [table_lines(table) for table in short],
        "conditions": [
            {
                "name": name,
                "failed": sum(table.failures.values()),
                "rows": table_lines(table),
            }
            for name, table in facts.conditions.items()
        ],
        "tables": [
            {
                "title": part.title,
                "note": _SURFACE_NOTES[part.surface],
                "surface": part.surface,
                "rows": table_lines(part.table, paper=paper and part.surface == "whole"),
                "differences": [_difference_rows(part.table, name) for name in others],
            }
            for part in facts.parts
        ],
        "methods": methods_sentence([*tables, *short], facts.asked.place),
        "comparisons": len(others) * sum(len(table.rows) for table in tables),
        "paper": PAPER_NOT_COMPARABLE if paper else "",
        "floor": FLOOR_NOTE if any(row.floor is not None for t in tables for row in t.rows) else "",
        "figures": _figures(facts, figures),
        "provenance": provenance_rows(run, facts.asked.place),
        "place": facts.asked.place,
    }


def _kind(kinds: list[str]) -> str:
    """The headline's colour: good news only where nothing is worse."""
    return "worse" if "worse" in kinds else "better" if kinds[:1] == ["better"] else ""


def _difference_rows(table: ComparisonTable, name: str) -> dict[str, Any]:
    rows = [
        {"name": full_row_name(row.metric), "cell": difference_cell(row, name)}
        for row in measured(table.rows)
    ]
    return {"strategy": strategy_label(name), "rows": rows}


# -- figures -------------------------------------------------------------------------------------------------


def _figures(facts: ComparisonFacts, figures: Path | None) -> list[Illustration]:
    run, headline, surface = facts.run, facts.headline, facts.parts[0].surface
    out = []
    if any(r.value(headline.key) is not None for r in run.records):
        place = facts.asked.place
        by = f"{place} by {place}" + (" and condition by condition" if len(run.plan.conditions) > 1 else "")
        out.append(
            embed(
                rocks_figure(run.records, facts.strategies, run.plan.worlds, headline),
                "rocks",
                f"{headline.label} of every mission, grouped by {place}, one colour and marker per strategy.",
                f"{metric_label(headline.key).full} {by}: every mission (dots) and each strategy’s mean (bars).",
                figures,
                title=f"{place} by {place}".capitalize(),
            )
        )
    sectors, centers = _sectors(facts, surface)
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
    facts: ComparisonFacts, surface: Surface | None
) -> tuple[dict[str, list[list[float | None]]], list[float]]:
    found: dict[str, list[list[float | None]]] = collections.defaultdict(list)
    centers: list[float] = []
    for name in facts.strategies:
        for r in facts.run.records if surface else ():
            metrics = r.metrics
            values, here = metrics.get(surface or "", {}).get(SECTOR_KEY), metrics.get("sector_centers_deg")
            if r.strategy == name and r.status != "failed" and values and here:
                centers = centers or list(here)
                if list(here) == centers:
                    found[strategy_label(name)].append(values)
    return dict(found), centers
