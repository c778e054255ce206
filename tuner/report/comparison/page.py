"""``report.html`` of ``gatetune evaluate``, ``confirm`` and ``reproduce``: strategies against each other."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from nbv.provenance import versions
from nbv.rocks.imported import are_photographed, is_photographed
from tuner.evaluation.baselines import description, sees_ground_truth
from tuner.evaluation.baselines import label as strategy_label
from tuner.evaluation.comparison import ComparisonTable
from tuner.evaluation.flying import EvaluationRun
from tuner.missions.registry import EXTERNAL
from tuner.report.comparison.facts import ComparisonFacts
from tuner.report.comparison.tables import (
    FLOOR_NOTE,
    PAPER_NOT_COMPARABLE,
    methods_sentence,
    missions_text,
    strategy_lines,
    table_lines,
)
from tuner.report.labels import format_number, metric_label
from tuner.report.pages import write_page
from tuner.report.provenance import recorded, recorded_rows
from tuner.report.style import short_names

REPORT_FILE = "report.html"
_TITLES = {
    "whole": "Table I on the whole surface, underside included, as in the paper",
    "observable": "Table I on the surface that at least two reachable cameras can see",
    "own": "Metrics and costs",
}


def write_comparison_report(
    facts: ComparisonFacts,
    directory: Path,
    *,
    title: str = "Strategies compared",
    paper: bool = False,
    command: str = "",
) -> Path:
    """Write ``report.html`` into ``directory``; returns its path.

    Parameters
    ----------
    facts
        From `comparison_facts`; the run may be incomplete.
    directory
        Where to.
    title
        The page's.
    paper
        Show the paper's Table I beside ours, with what is not comparable.
    command
        The command line that repeats the evaluation.

    Raises
    ------
    UserError
        The directory cannot be written.
    """
    return write_page(
        directory / REPORT_FILE,
        "comparison.html.j2",
        title=f"{title} · gatetune",
        heading=title,
        command=command,
        version=versions().get("gatetune", ""),
        **comparison_context(facts, paper=paper),
    )


def comparison_context(facts: ComparisonFacts, *, paper: bool = False) -> dict[str, Any]:
    """Everything that the template ``comparison.html.j2`` shows of the facts."""
    run, tables = facts.run, list(facts.tables.values())
    kinds = [line.kind for line in facts.verdicts]
    several = len(run.plan.conditions) > 1
    return {
        "facts": facts,
        "kind": "worse" if "worse" in kinds else "better" if kinds[:1] == ["better"] else "",
        "reference": strategy_label(facts.reference),
        "place": facts.asked.place,
        "ours": run.plan.fidelity != EXTERNAL,
        "truth": _truth(run.plan.rocks),
        "strategies": {
            "": _strategies(run, facts.summary),
            **{name: _strategies(run, table) for name, table in facts.conditions.items()},
        },
        "labels": [strategy_label(name) for name in run.plan.strategies],
        "worlds": [name if several else name.partition(",")[0] for name in _world_names(run)],
        "by_world": _by_world(facts),
        "headline": metric_label(facts.headline.key).full,
        "tables": [
            {"title": _TITLES[name], "lines": table_lines(table, paper=paper and name == "whole")}
            for name, table in facts.tables.items()
        ],
        "methods": methods_sentence([facts.summary, *tables], facts.asked.place),
        "paper": PAPER_NOT_COMPARABLE if paper else "",
        "floor": FLOOR_NOTE if any(row.floor is not None for t in tables for row in t.rows) else "",
        "provenance": _provenance(run, facts.asked.place),
    }


def _truth(rocks: Sequence[str]) -> str:
    """What clouds are measured against."""
    if are_photographed(rocks):
        return "the set's own reference"
    return "ground truth" + (" or a set's own reference" if any(map(is_photographed, rocks)) else "")


def _strategies(run: EvaluationRun, table: ComparisonTable) -> dict[str, Any]:
    """A row per strategy: what it does, what was found, how many missions."""
    columns, lines = strategy_lines(table)
    rows = []
    for line in lines:
        what = description(line.name) + ("; sees the ground truth" if sees_ground_truth(line.name) else "")
        if (owner := run.plan.owner(line.name)) != line.name:
            what += f"; the same missions as {strategy_label(owner)}"
        rows.append((strategy_label(line.name), what, line.cells, missions_text(table, line.name)))
    return {"columns": columns, "rows": rows}


def _world_names(run: EvaluationRun) -> list[str]:
    stems = dict(zip(run.plan.rocks, short_names(run.plan.rocks)))
    return [f"{stems[world.rock]}, {world.condition}" for world in run.plan.worlds]


def _by_world(facts: ComparisonFacts) -> list[tuple[str, list[str]]]:
    """The mean of every strategy in every world, in the quality or the only objective."""
    run, row = facts.run, facts.headline
    out = []
    for name in run.plan.strategies:
        cells = []
        for world in run.plan.worlds:
            own = [r.value(row.key) for r in run.records if r.strategy == name and r.world == world]
            known = [value for value in own if value is not None]
            cells.append(format_number(sum(known) / len(known) if known else None, row.decimals))
        out.append((strategy_label(name), cells))
    return out


def _provenance(run: EvaluationRun, place: str) -> list[tuple[str, str]]:
    """Rocks, conditions, versions and revisions."""
    plan = run.plan
    first, last = plan.first_replicate, plan.first_replicate + plan.replicates - 1
    return [
        (f"{place}s", ", ".join(short_names(plan.rocks))),
        ("conditions", ", ".join(condition.name for condition in plan.conditions)),
        ("replicates", f"{first} to {last}" if last > first else str(first)),
        ("mission preset", ", ".join(sorted({config.preset for config in plan.strategies.values()}))),
        *recorded_rows(recorded([Path(r.directory) for r in run.records])),
    ]
