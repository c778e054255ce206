"""Everything that a comparison says, once, for its page, the terminal and scripts."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from nbv.rocks.imported import are_photographed
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
from tuner.report.comparison.verdicts import Sentence, counted, row_of, share_kept, verdicts
from tuner.report.labels import metric_label

SURFACES: tuple[Literal["whole", "observable"], ...] = ("whole", "observable")
OURS_COST = (Objective(PHOTOGRAPHS, "minimise"), Objective("costs.flight_time_s", "minimise"))


@dataclass(frozen=True)
class ComparisonFacts:
    """What was found: sentences, then tables from the shortest to the longest."""

    run: EvaluationRun
    asked: Asked
    reference: str
    notes: tuple[str, ...]  # what to know before the verdicts
    verdicts: list[Sentence]
    warnings: list[str]
    measure: str
    summary: ComparisonTable  # costs, the objectives and the limit
    conditions: dict[str, ComparisonTable]  # the same, condition by condition; empty where there is one
    tables: dict[str, ComparisonTable]  # Table I by surface; "own" of missions that are not ours

    @property
    def headline(self) -> MetricRow:
        """The quality, or the only objective."""
        return row_of(self.asked.quality or self.asked.objective)

    def to_dict(self) -> dict[str, Any]:
        """JSON form; means, intervals and differences (strategy minus reference) in the metrics' units."""
        plan = self.run.plan
        return {
            "complete": self.run.complete,
            "rocks": list(plan.rocks),
            "replicates": plan.replicates,
            "reference": self.reference,
            "measure": self.measure,
            "notes": list(self.notes),
            "verdicts": [line._asdict() for line in self.verdicts],
            "warnings": self.warnings,
            "failures": self.run.failures,
            "summary": dataclasses.asdict(self.summary),
            "conditions": {name: dataclasses.asdict(table) for name, table in self.conditions.items()},
            "tables": {name: dataclasses.asdict(table) for name, table in self.tables.items()},
        }


def comparison_facts(
    run: EvaluationRun, reference: str | None = None, asked: Asked | None = None, notes: Sequence[str] = ()
) -> ComparisonFacts:
    """What ``run`` says of its strategies.

    Parameters
    ----------
    run
        What was flown, complete or not.
    reference
        Strategy against which differences are taken. None: ``hyb-h`` where it was evaluated (the paper's default
        configuration), else the first strategy.
    asked
        The objectives, and the limit where there is one; by default the F-score alone.
    notes
        What to know before the verdicts.

    Raises
    ------
    UserError
        The reference was not evaluated.
    """
    records, plan = run.records, run.plan
    strategies = tuple(plan.strategies)
    asked = asked or Asked(Objective())
    against = reference or ("hyb-h" if "hyb-h" in strategies else strategies[0])
    ours = plan.fidelity != EXTERNAL
    if ours or any("whole" in r.metrics for r in records):
        tables: dict[str, ComparisonTable] = {
            s: comparison_table(records, strategies, against, s) for s in SURFACES
        }
    else:
        rows = mission_file_rows(asked.quality or asked.objective, records)
        tables = {"own": comparison_table(records, strategies, against, None, rows)}

    def summary(own: Sequence[Trial]) -> ComparisonTable:
        return _summary(own, strategies, against, asked, OURS_COST if ours else ())

    conditions = [c.name for c in plan.conditions] if len(plan.conditions) > 1 else []
    return ComparisonFacts(
        run,
        asked,
        against,
        tuple(notes),
        verdicts(run, against, asked),
        _warnings(run, asked.place),
        _measure(run, asked),
        summary(records),
        {name: summary([r for r in records if r.condition == name]) for name in conditions},
        tables,
    )


def _summary(
    records: Sequence[Trial],
    strategies: Sequence[str],
    reference: str,
    asked: Asked,
    costs: Sequence[Objective],
) -> ComparisonTable:
    """Costs, what the campaign was asked for, and the share of rocks that kept its limit."""
    objectives = [o for o in (asked.objective, asked.second) if o is not None and o != asked.quality]
    counts = {o.metric: o for o in (*objectives, *costs)}
    rows = [_counted(records, strategies, o) for o in counts.values()]
    quality = [row_of(asked.quality)] if asked.quality else []
    table = comparison_table(records, strategies, reference, None, quality)
    rows += table.rows
    if asked.limit is not None:
        shares = {name: share_kept(records, name, asked) for name in strategies}
        limit = MetricRow("", "Limit kept", "limit", f"% of {asked.place}s", True, 0)
        rows.append(ComparisonRow(limit, shares, _best(shares, max), None, {}))
    return dataclasses.replace(table, rows=rows)


def _counted(records: Sequence[Trial], strategies: Sequence[str], o: Objective) -> ComparisonRow:
    cells = {name: strategy_interval(records, name, o.metric) for name in strategies}
    whole = all(cell is None or cell.mean.is_integer() or cell.mean >= 100 for cell in cells.values())
    best = _best(cells, min if o.direction == "minimise" else max)
    return ComparisonRow(row_of(o, decimals=0 if whole else 1), cells, best, None, {})


def _best(cells: dict[str, Interval | None], pick: Callable[[list[float]], float]) -> tuple[str, ...]:
    means = {name: cell.mean for name, cell in cells.items() if cell is not None}
    return tuple(name for name, mean in means.items() if mean == pick(list(means.values())))


def _measure(run: EvaluationRun, asked: Asked) -> str:
    """Which surface, fidelity and condition the verdict is of."""
    label = metric_label((asked.quality or asked.objective).metric)
    places = counted(len(run.plan.rocks), asked.place)
    if run.plan.fidelity == EXTERNAL:
        return f"{label.full}; missions of your mission file; {places}."
    names = [condition.name for condition in run.plan.conditions]
    where = f"{'conditions' if len(names) > 1 else 'condition'} {', '.join(names)}"
    flown = f"{run.plan.fidelity} missions"
    if are_photographed(run.plan.rocks):
        flown = "missions over photographs that were taken"
    return f"{label.full}; {flown}; {where}; {places}."


def _warnings(run: EvaluationRun, place: str) -> list[str]:
    out, plan = [], run.plan
    if not run.complete:
        expected = len(plan.strategies) * len(plan.worlds) * plan.replicates
        out.append(
            f"Not complete: {len(run.records)} of {expected} missions are finished; the same command goes on."
        )
    failed = {
        name: sum(r.strategy == name and r.status == "failed" for r in run.records)
        for name in plan.strategies
    }
    if any(failed.values()):
        listed = ", ".join(f"{strategy_label(name)} {n}" for name, n in failed.items() if n)
        reasons = ", ".join(f"{reason} {n}" for reason, n in run.failures.items())
        out.append(
            f"Failed missions are left out of all means and differences ({listed}; reasons: {reasons}). "
            "A strategy that fails where others succeed is worse than its means say."
        )
    if len(plan.rocks) < 3:
        out.append(f"Only {counted(len(plan.rocks), place)}: nothing here speaks for other {place}s.")
    return out
