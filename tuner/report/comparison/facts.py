"""Everything that a comparison says, once, for its page, the terminal and scripts."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from tuner.evaluation.baselines import TUNED, TUNED_POOL_RANDOM
from tuner.evaluation.baselines import label as strategy_label
from tuner.evaluation.comparison import ComparisonRow, ComparisonTable, comparison_table, strategy_interval
from tuner.evaluation.flying import EvaluationRun
from tuner.evaluation.of_campaign import Asked
from tuner.evaluation.paper_table import MetricRow
from tuner.evaluation.statistics import Interval
from tuner.missions.job import Trial
from tuner.missions.registry import EXTERNAL
from tuner.problem.exact_costs import PHOTOGRAPHS
from tuner.problem.objective import Objective
from tuner.report.comparison.tables import mission_file_rows
from tuner.report.comparison.verdicts import (
    Sentence,
    counted,
    other_strategies,
    row_of,
    share_kept,
    verdicts,
)
from tuner.report.labels import metric_label

Surface = Literal["whole", "observable"]
SURFACES: tuple[Surface, ...] = ("whole", "observable")


@dataclass(frozen=True)
class Part:
    """A table and what it is of."""

    title: str
    surface: Surface | None  # None: missions that are not ours, in their own metrics
    table: ComparisonTable


@dataclass(frozen=True)
class ComparisonFacts:
    """What was found: sentences, then tables from the shortest to the longest."""

    run: EvaluationRun
    asked: Asked
    reference: str
    notes: tuple[str, ...]  # what to know before the verdicts
    verdicts: list[Sentence]
    others: list[Sentence]  # of the strategies that no verdict is on
    warnings: list[str]
    measure: str
    headline: MetricRow  # the quality, or the only objective
    summary: (
        ComparisonTable | None
    )  # the objectives, photographs and the limit; None where a longer table has all
    conditions: dict[str, ComparisonTable]  # the same, condition by condition; empty where there is one
    parts: list[Part]

    @property
    def strategies(self) -> tuple[str, ...]:
        """In the order of the tables."""
        return in_order(self.run.plan.strategies)

    def to_dict(self) -> dict[str, Any]:
        """JSON form; means, intervals and differences (strategy minus reference) in the metrics' units."""
        return {
            "complete": self.run.complete,
            "rocks": list(self.run.plan.rocks),
            "replicates": self.run.plan.replicates,
            "reference": self.reference,
            "measure": self.measure,
            "notes": list(self.notes),
            "verdicts": [line._asdict() for line in self.verdicts],
            "others": [line._asdict() for line in self.others],
            "warnings": self.warnings,
            "failures": self.run.failures,
            "summary": None if self.summary is None else dataclasses.asdict(self.summary),
            "conditions": {name: dataclasses.asdict(table) for name, table in self.conditions.items()},
            "tables": {part.surface or "own": dataclasses.asdict(part.table) for part in self.parts},
        }


def comparison_facts(
    run: EvaluationRun,
    reference: str | None = None,
    asked: Asked | None = None,
    surfaces: Sequence[Surface] = SURFACES,
    notes: Sequence[str] = (),
) -> ComparisonFacts:
    """What ``run`` says of its strategies.

    Parameters
    ----------
    reference
        Strategy against which differences are taken. None: ``hyb-h`` where it was evaluated (the paper's default
        configuration), else the first strategy.
    asked
        The objectives, and the limit where there is one; by default the F-score alone.
    surfaces
        One table each.

    Raises
    ------
    UserError
        The reference was not evaluated.
    """
    strategies, records, plan = in_order(run.plan.strategies), run.records, run.plan
    asked = asked or Asked(Objective())
    against = reference or ("hyb-h" if "hyb-h" in strategies else strategies[0])
    measured = plan.fidelity != EXTERNAL or any("whole" in r.metrics for r in records)
    if measured:
        parts = [
            Part(f"{s.capitalize()} surface", s, comparison_table(records, strategies, against, s))
            for s in surfaces
        ]
    else:
        rows = mission_file_rows(asked.quality or asked.objective, records)
        table = comparison_table(records, strategies, against, None, rows)
        parts = [Part("Metrics and costs", None, table)]
    of_campaign = TUNED in strategies and (measured or asked.second is not None)
    several = len(plan.conditions) > 1

    def summary(own: Sequence[Trial]) -> ComparisonTable:
        return _summary(own, strategies, against, asked, photographs=plan.fidelity != EXTERNAL)

    return ComparisonFacts(
        run,
        asked,
        against,
        tuple(notes),
        verdicts(run, against, asked),
        other_strategies(run, against, asked),
        _warnings(run, parts[0].table, asked.place),
        _measure(run, asked),
        row_of(asked.quality or asked.objective),
        summary(records) if of_campaign else None,
        {c.name: summary([r for r in records if r.condition == c.name]) for c in plan.conditions}
        if several
        else {},
        parts,
    )


def in_order(strategies: Iterable[str]) -> tuple[str, ...]:
    """As planned, chance in the tuned pool beside chance in the default's."""
    names = list(strategies)
    if TUNED_POOL_RANDOM in names and "random" in names:
        names.remove(TUNED_POOL_RANDOM)
        names.insert(names.index("random") + 1, TUNED_POOL_RANDOM)
    return tuple(names)


def _summary(
    records: Sequence[Trial],
    strategies: Sequence[str],
    reference: str,
    asked: Asked,
    *,
    photographs: bool,
) -> ComparisonTable:
    """Photographs, what the campaign was asked for, and the share of rocks that kept its limit."""
    counts = [o for o in (asked.objective, asked.second) if o is not None and o != asked.quality]
    if photographs and PHOTOGRAPHS not in [o.metric for o in counts]:
        counts.insert(0, Objective(PHOTOGRAPHS, "minimise"))
    surface = metric_label(asked.quality.metric).surface if asked.quality else ""
    rows = [_counted(records, strategies, o) for o in counts]
    quality = [row_of(asked.quality, surface.capitalize())] if asked.quality else []
    table = comparison_table(records, strategies, reference, None, quality)
    rows += table.rows
    if asked.limit is not None:
        shares = {name: share_kept(records, name, asked) for name in strategies}
        limit = MetricRow(surface.capitalize(), "Limit kept", "limit", f"% of {asked.place}s", True, 0)
        rows.append(ComparisonRow(limit, shares, _best(shares, max), None, {}))
    return dataclasses.replace(table, rows=rows)


def _counted(records: Sequence[Trial], strategies: Sequence[str], o: Objective) -> ComparisonRow:
    cells = {name: strategy_interval(records, name, o.metric) for name in strategies}
    whole = all(cell is None or cell.mean.is_integer() for cell in cells.values())
    best = _best(cells, min if o.direction == "minimise" else max)
    return ComparisonRow(row_of(o, decimals=0 if whole else 1), cells, best, None, {})


def _best(cells: dict[str, Interval | None], pick: Callable[[list[float]], float]) -> tuple[str, ...]:
    means = {name: cell.mean for name, cell in cells.items() if cell is not None}
    return tuple(name for name, mean in means.items() if mean == pick(list(means.values())))


def _measure(run: EvaluationRun, asked: Asked) -> str:
    """Which surface, fidelity and condition the verdict is of."""
    names = [condition.name for condition in run.plan.conditions]
    where = f"{'conditions' if len(names) > 1 else 'condition'} {', '.join(names)}; "
    label, places = (
        metric_label((asked.quality or asked.objective).metric),
        counted(len(run.plan.rocks), asked.place),
    )
    if run.plan.fidelity == EXTERNAL:
        return f"{label.full}; missions of your mission file; {places}."
    return f"{label.full}; {run.plan.fidelity} missions; {where}{places}."


def _warnings(run: EvaluationRun, table: ComparisonTable, place: str) -> list[str]:
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
        out.append(f"Only {counted(len(run.plan.rocks), place)}: nothing here speaks for other {place}s.")
    return out
