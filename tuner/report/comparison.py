"""The result of an evaluation: verdicts, tables and page.

``report.html`` of ``gatetune evaluate``, ``confirm`` and ``reproduce``, the same on the terminal, and as JSON for scripts.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tuner.comparison.of_campaign import ComparisonSpec
from tuner.comparison.plan import EvaluationPlan
from tuner.comparison.run import EvaluationRun
from tuner.comparison.statistics import (
    PAPER_TABLE_I,
    TABLE_I_ROWS,
    TABLE_I_ROWS_OBSERVABLE,
    ComparisonRow,
    ComparisonTable,
    Interval,
    MetricRow,
    comparison_table,
    same_photographs,
    share_kept,
    strategy_interval,
)
from tuner.comparison.verdict import Kind, Verdict, judge
from tuner.missions.job import Trial
from tuner.missions.registry import kind_on, mission_kind
from tuner.problem.baselines import (
    PAPER_STRATEGIES,
    TUNED,
    controls_at_equal_number,
    description,
    in_table_order,
    sees_ground_truth,
)
from tuner.problem.baselines import label as strategy_label
from tuner.problem.deterministic_metrics import PHOTOGRAPHS
from tuner.problem.objective import Objective
from tuner.report.labels import (
    MISSING,
    counted,
    decimals_for,
    difference_text,
    format_number,
    gain_words,
    interval_methods,
    interval_text,
    measure_text,
    metric_label,
    with_unit,
)
from tuner.report.pages import recorded, recorded_rows, write_page
from tuner.report.style import short_names
from tuner.report.table import Cell, Row, Table

REPORT_FILE = "report.html"
COSTS_SHOWN = (Objective(PHOTOGRAPHS, "minimise"), Objective("costs.flight_time_s", "minimise"))
_TITLES = {
    "whole": "Table I on the whole surface, including the underside, as in the paper",
    "observable": "Table I on the surface that at least two reachable cameras can see",
    "own": "Metrics and costs",
}
FLOOR_NOTE = (
    "The rocks’ own floor is the value of a perfect reconstruction: surface that no reachable camera sees, or that is removed "
    "with the ground, has a distance to every cloud."
)


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
    own = sum(name in PAPER_STRATEGIES for name in names)
    more = f" and {counted(len(names) - own, 'reference')}" if own < len(names) else ""
    return f"{own} of the paper's {len(PAPER_STRATEGIES)} strategies{more}"


class Sentence(NamedTuple):
    """One line for a reader, and whether it is good news."""

    text: str
    kind: str = ""  # better, worse, no


TONES = {Kind.BETTER: "better", Kind.NOT_WORSE: "better", Kind.WORSE: "worse"}


def verdict_text(verdict: Verdict, word: str = "rock", whom: str = "") -> str:
    """The verdict as a sentence; ``whom``: what the reference is called, where not by its label."""
    label, gain = metric_label(verdict.metric), verdict.gain
    who, whom = strategy_label(verdict.strategy), whom or strategy_label(verdict.reference)
    if gain is None:
        return f"{who}: no mission in common with {whom}."
    allowed = f" by more than {with_unit(verdict.margin, label.difference_unit)}" if verdict.margin else ""
    begin = {
        Kind.BETTER: f"{who} is better than {whom}",
        Kind.WORSE: f"{who} is worse than {whom}{allowed}",
        Kind.NOT_WORSE: f"{who} is not worse than {whom}{allowed}",
        Kind.UNDECIDED: f"Not known whether {who} is worse than {whom}{allowed}",
        Kind.NO_DIFFERENCE: f"No difference detected between {who} and {whom}",
        Kind.NO_INTERVAL: f"{who} against {whom}",
    }[verdict.kind]
    bounds = "too few missions for an interval"
    if gain.low is not None:
        bounds = interval_text((gain.low, gain.high), signed=True)
    where = f"{counted(gain.missions, 'paired mission')} on {counted(gain.rocks, word)}"
    if gain.method == "replicates":  # such an interval has no spread between rocks
        where += f", valid for {'this one' if gain.rocks == 1 else 'these'} only"
    return f"{begin} in {label.full}: {gain_words(gain.mean, label.difference_unit)} ({bounds}; {where})."


class ComparisonFacts:
    """What an evaluation says of its strategies: sentences, then tables from the shortest to the longest.

    ``reference``: strategy from which differences are taken. None: ``hyb-h`` where it was evaluated (the paper's default
    configuration), else the first strategy. ``asked``: the objectives, and the limit where there is one; by default the
    F-score alone. ``notes``: what to know before the verdicts.
    """

    def __init__(
        self,
        run: EvaluationRun,
        reference: str | None = None,
        asked: ComparisonSpec | None = None,
        notes: Sequence[str] = (),
    ) -> None:
        self.run, self.records, self.plan, self.notes = run, run.records, run.plan, tuple(notes)
        self.asked = asked or ComparisonSpec()
        self.strategies = tuple(in_table_order(self.plan.strategies))
        self.reference = reference or ("hyb-h" if "hyb-h" in self.strategies else self.strategies[0])
        self.word = self.asked.instance_word
        label = metric_label(self.asked.shown.metric)
        names = [c.name for c in self.plan.conditions]
        measure = measure_text(label.full, self.plan.fidelity, self.plan.rocks, names)
        self.measure = f"{measure}; {counted(len(self.plan.rocks), self.word)}."

    def to_dict(self) -> dict[str, Any]:
        """For JSON (`nbv.convert.json_ready`); means, intervals and differences (strategy minus reference) in the metrics' units."""
        return {
            "complete": self.run.complete,
            "rocks": self.plan.rocks,
            "replicates": self.plan.replicates,
            "reference": self.reference,
            "measure": self.measure,
            "notes": self.notes,
            "verdicts": [line._asdict() for line in self.verdicts],
            "warnings": self.warnings,
            "failures": self.run.failures,
            "summary": self.summary,
            "conditions": self.conditions,
            "tables": self.tables,
        }

    # -- tables --------------------------------------------------------------------------------------------------

    @cached_property
    def tables(self) -> dict[str, ComparisonTable]:
        """Table I by surface; "own" where no mission has those metrics: the metric of a mission file, and costs."""
        rows: dict[str, Sequence[MetricRow]] = {"whole": TABLE_I_ROWS, "observable": TABLE_I_ROWS_OBSERVABLE}
        if not any("whole" in r.metrics for r in self.records):
            shown = self.asked.shown
            costs = sorted({f"costs.{name}" for r in self.records for name in r.costs} - {shown.metric})
            rows = {"own": [self._row_of(o) for o in (shown, *(Objective(n, "minimise") for n in costs))]}
        return {
            name: comparison_table(self.records, self.strategies, self.reference, of)
            for name, of in rows.items()
        }

    def _row_of(self, o: Objective) -> MetricRow:
        """A row of a mission file's metric, with as many decimals as its spread deserves."""
        values = [value for r in self.records if (value := r.measured(o)) is not None]
        digits = decimals_for(float(np.std(values))) if values else 1
        return dataclasses.replace(_row_of(o), decimals=digits)

    @cached_property
    def summary(self) -> ComparisonTable:
        """The campaign's objectives, costs, and the share of rocks that met its constraint."""
        return self._summary(self.records)

    @cached_property
    def conditions(self) -> dict[str, ComparisonTable]:
        """The same, condition by condition; empty where there is one."""
        names = [c.name for c in self.plan.conditions]
        return {
            name: self._summary([r for r in self.records if r.condition == name])
            for name in names
            if len(names) > 1
        }

    def _summary(self, records: Sequence[Trial]) -> ComparisonTable:
        asked = self.asked
        costs = [o for o in COSTS_SHOWN if any(r.measured(o) is not None for r in records)]
        quality = asked.goal.quality
        objectives = [o for o in asked.goal.objectives if o != quality]
        counts = {o.metric: o for o in (*objectives, *costs)}
        rows = [_row_of(o) for o in (*counts.values(), *([quality] if quality else []))]
        table = comparison_table(records, self.strategies, self.reference, rows)
        # A cost is read beside the others': its difference would only be in the way.
        found = [
            dataclasses.replace(row, differences={}) if row.metric.key in counts else row
            for row in table.rows
        ]
        if asked.goal.limit is not None:
            shares = {name: self._share(records, name) for name in self.strategies}
            most = max((share.mean for share in shares.values() if share is not None), default=0.0)
            best = tuple(name for name, share in shares.items() if share is not None and share.mean == most)
            limit = MetricRow("", "Constraint met", "limit", f"% of {self.word}s", True, 0)
            found.append(ComparisonRow(limit, shares, best, None, {}))
        return dataclasses.replace(table, rows=found)

    def _share(self, records: Sequence[Trial], strategy: str) -> Interval | None:
        goal = self.asked.goal
        assert goal.second is not None and goal.limit is not None
        return share_kept(records, strategy, goal.second, goal.limit, exact=goal.second in goal.decided)

    # -- sentences -----------------------------------------------------------------------------------------------

    @cached_property
    def verdicts(self) -> list[Sentence]:
        """The verdict on the tuned strategy, without one on the first that is not the reference, line by line."""
        goal, reference = self.asked.goal, self.reference
        others = [name for name in self.plan.strategies if name != reference]
        if not others:
            return []
        subject = TUNED if TUNED in others else others[0]
        of_paper = [name for name in others if name in PAPER_STRATEGIES]
        out = []
        for name in (
            [subject] if TUNED in others or reference not in PAPER_STRATEGIES else of_paper or [subject]
        ):
            if self.plan.owner(name) == self.plan.owner(reference):
                continue
            if same_photographs(self.records, (reference, name)):
                both = strategy_label(name), strategy_label(reference)
                out.append(
                    Sentence("{} took the same photographs as {} in every mission.".format(*both), "no")
                )
                continue
            out += [self._count(name, o) for o in goal.decided]
            if goal.quality is not None:
                margin = 0.0 if goal.limit is None else self.asked.margin
                out.append(self._quality(name, reference, goal.quality, margin))
        if subject == TUNED and goal.limit is not None:
            out += self._limit()
        if subject == TUNED and goal.quality is not None:
            out += self._best_control(goal.quality)
        return out

    def _count(self, name: str, o: Objective) -> Sentence:
        """``Photographs: 26, and 32 for Hyb-H.``; a deterministic metric has no interval."""
        own, theirs = (strategy_interval(self.records, n, o.metric) for n in (name, self.reference))
        whom = strategy_label(self.reference)
        if own is None or theirs is None:
            return Sentence(f"{strategy_label(name)}: no mission in common with {whom}.")
        gain = o.sign * (own.mean - theirs.mean)
        text = f"{metric_label(o.metric).name}: {own.mean:.4g}, and {theirs.mean:.4g} for {whom}."
        return Sentence(text, "better" if gain > 0 else "worse" if gain < 0 else "no")

    def _quality(
        self, name: str, reference: str, quality: Objective, margin: float, whom: str = ""
    ) -> Sentence:
        """Whether a strategy's quality is better, worse, or no worse by more than the margin."""
        verdict = judge(self.records, name, reference, quality, margin)
        return Sentence(verdict_text(verdict, self.word, whom), TONES.get(verdict.kind, "no"))

    def _limit(self) -> list[Sentence]:
        goal, share = self.asked.goal, self._share(self.records, TUNED)
        if share is None or goal.second is None:
            return []
        label, kept = metric_label(goal.second.metric), round(share.mean * share.rocks / 100)
        bound = "at least" if goal.second.direction == "maximise" else "at most"
        text = f"Constraint ({label.full}: {bound} {goal.limit:g} {label.unit}".rstrip()
        text += f"): met on {kept} of {counted(share.rocks, self.word)}"
        if share.low is not None and share.high is not None:
            text += f" ({share.mean:.0f} %, 95 % interval {share.low:.0f} to {share.high:.0f} %)"
        return [Sentence(f"{text}.", "better" if kept == share.rocks else "worse" if kept == 0 else "no")]

    def _best_control(self, quality: Objective) -> list[Sentence]:
        """The verdict against the best control with as many photographs, other than the reference; empty if none was run."""
        names = [name for name in controls_at_equal_number(self.plan.strategies) if name != self.reference]
        means = {name: strategy_interval(self.records, name, quality.metric) for name in names}
        known = {name: quality.sign * cell.mean for name, cell in means.items() if cell is not None}
        if not known:
            return []
        best = max(known, key=lambda name: known[name])
        whom = f"the best control with as many photographs ({strategy_label(best)})"
        return [self._quality(TUNED, best, quality, 0.0, whom)]

    @cached_property
    def warnings(self) -> list[str]:
        """What limits the outcome."""
        out, run, plan = [], self.run, self.plan
        if not run.complete:
            finished = f"{len(run.records)} of {plan.combinations} missions are finished"
            out.append(f"Not complete: {finished}; repeat the command to continue.")
        failed = self.summary.failures
        if run.failures:
            listed = ", ".join(f"{strategy_label(n)} {failed[n]}" for n in plan.strategies if failed[n])
            reasons = ", ".join(f"{reason} {n}" for reason, n in run.failures.items())
            out.append(
                f"Failed missions are left out of all means and differences ({listed}; reasons: {reasons}). "
                "A strategy that fails where others succeed is worse than its means show."
            )
        if len(plan.rocks) < 3:
            out.append(
                f"Only {counted(len(plan.rocks), self.word)}: no result here carries over to other {self.word}s."
            )
        return out


def _row_of(objective: Objective) -> MetricRow:
    """A table row in the direction of an objective."""
    label = metric_label(objective.metric)
    return MetricRow("", label.name, objective.metric, label.unit, objective.direction == "maximise")


# -- tables --------------------------------------------------------------------------------------------------


def table_by_strategy(
    table: ComparisonTable, title: str, run: EvaluationRun | None = None, word: str = "rock"
) -> Table:
    """A row per strategy; with its ``run`` what each strategy does. Values are means over ``word`` s."""
    rows = []
    for name in table.strategies:
        note = "" if run is None else _what(name, run)
        cells = [cell(row, name) for row in table.rows]
        rows.append(Row(_label_in(table, name), (*cells, _missions(table, name)), note))
    caption = (
        f"Each value is the mean over {word}s ± half of its 95 % interval; the best one is marked. Below it is the "
        f"paired difference from {strategy_label(table.reference)}."
    )
    return Table(
        title, ("strategy", *(_row_name(row.metric) for row in table.rows), "missions"), rows, caption
    )


def _label_in(table: ComparisonTable, name: str) -> str:
    """``Hyb-H = B-aware`` where it took the photographs of an earlier strategy in every mission."""
    same = table.same.get(name)
    return strategy_label(name) + (f" = {strategy_label(same)}" if same else "")


def _what(name: str, run: EvaluationRun) -> str:
    what = description(name) + ("; sees the ground truth" if sees_ground_truth(name) else "")
    owner = run.plan.owner(name)
    return what if owner == name else f"{what}; the same missions as {strategy_label(owner)}"


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
        rows.append(Row(_row_name(row.metric), tuple(cells)))
        if row.floor is not None:
            floor = Cell(format_number(row.floor, row.metric.decimals))
            name = f"– the rocks’ own floor ({row.metric.unit})"
            rows.append(Row(name, (floor,) * len(table.strategies)))
    rows.append(Row("missions", tuple(_missions(table, name) for name in table.strategies)))
    return Table(title, ("metric", *(_label_in(table, name) for name in table.strategies)), rows)


def _table_by_instance(facts: ComparisonFacts) -> Table:
    """The mean of every strategy in every instance, in the quality or the only objective."""
    plan, o = facts.plan, facts.asked.shown
    stems = dict(zip(plan.rocks, short_names(plan.rocks)))
    several = len(plan.conditions) > 1
    names = [f"{stems[w.rock]}, {w.condition}" if several else stems[w.rock] for w in plan.instances]
    rows = []
    for name in plan.strategies:
        own = [r for r in facts.run.records if r.strategy == name]
        found = [[r.measured(o) for r in own if r.instance == instance] for instance in plan.instances]
        known = [[value for value in values if value is not None] for values in found]
        means = (format_number(float(np.mean(values)) if values else None) for values in known)
        rows.append([strategy_label(name), *means])
    caption = f"{metric_label(o.metric).full}, mean over replicates."
    return Table.of("", ("strategy", *names), rows, caption)


def cell(row: ComparisonRow, strategy: str, *, paper: bool = False, difference: bool = True) -> Cell:
    """The cell of ``strategy`` in ``row``, marked as best unless all strategies are equal."""
    metric, known = row.metric, sum(value is not None for value in row.cells.values())
    theirs = PAPER_TABLE_I.get(strategy, {}).get(metric.key) if paper else None
    d = row.differences.get(strategy) if difference else None
    below = [] if theirs is None else [f"paper {format_number(theirs, metric.decimals)}"]
    below += [] if d is None else [difference_text(d, metric.decimals)]
    best = strategy in row.best and known > len(row.best)
    return Cell(_interval_text(row.cells[strategy], metric.decimals), best, tuple(below))


def _missions(table: ComparisonTable, strategy: str) -> Cell:
    """``11 + 1 failed``."""
    failed = table.failures[strategy]
    return Cell(f"{table.missions[strategy]}" + (f" + {failed} failed" if failed else ""))


def _interval_text(interval: Interval | None, decimals: int) -> str:
    """``71.2 ± 3.1``; bounds are written out where they are not symmetric; a dash without a mission."""
    if interval is None:
        return MISSING
    mean = format_number(interval.mean, decimals)
    if interval.low is None or interval.high is None or interval.low == interval.high:
        return mean  # a count that every mission shares has no width
    if interval.method == "wilson":
        return f"{mean} [{format_number(interval.low, decimals)}, {format_number(interval.high, decimals)}]"
    return f"{mean} ± {format_number((interval.high - interval.low) / 2, decimals)}"


def _row_name(metric: MetricRow) -> str:
    """``Hausdorff ↓ (mm)``."""
    unit = f" ({metric.unit})" if metric.unit else ""
    return f"{metric.label} {'↑' if metric.higher_is_better else '↓'}{unit}"


# -- the page ------------------------------------------------------------------------------------------------


def write_comparison_report(
    facts: ComparisonFacts,
    directory: Path,
    *,
    title: str = "Strategies compared",
    paper: bool = False,
    command: str = "",
) -> Path:
    """Write ``report.html`` into ``directory``; returns its path.

    ``paper``: show the paper's Table I beside the measured one, with what is not comparable.

    Raises `UserError`: the directory cannot be written.
    """
    run, plan, tables = facts.run, facts.plan, list(facts.tables.values())
    kinds = [line.kind for line in facts.verdicts]
    rows = [row for table in (facts.summary, *tables) for row in table.rows]
    methods = {i.method for row in rows for i in (*row.cells.values(), *row.differences.values()) if i}
    return write_page(
        directory / REPORT_FILE,
        "comparison.html.j2",
        strategies=strategies_text(plan.strategies) if paper else f"{len(plan.strategies)} strategies",
        title=f"{title} · gatetune",
        heading=title,
        command=command,
        facts=facts,
        kind="worse" if "worse" in kinds else "better" if kinds[:1] == ["better"] else "",
        reference=strategy_label(facts.reference),
        truth=_truth(plan),
        summary=table_by_strategy(facts.summary, "", run, facts.word),
        conditions=[
            table_by_strategy(table, f"Under {name}", None, facts.word)
            for name, table in facts.conditions.items()
        ],
        instances=_table_by_instance(facts) if len(plan.instances) > 1 else None,
        tables=[
            table_i(table, _TITLES[name], paper=paper and name == "whole")
            for name, table in facts.tables.items()
        ],
        methods=interval_methods(methods, facts.word),
        paper=paper_note(plan.fidelity) if paper else "",
        floor=FLOOR_NOTE if any(row.floor is not None for row in rows) else "",
        provenance=_provenance(run, facts.word),
    )


def _truth(plan: EvaluationPlan) -> str:
    """What clouds are measured against; empty where it is not known, or there are none."""
    return " or ".join(sorted({kind_on(rock, plan.fidelity).truth for rock in plan.rocks} - {""}))


def _provenance(run: EvaluationRun, word: str) -> list[tuple[str, str]]:
    """Rocks, conditions, versions and revisions."""
    plan = run.plan
    first, last = plan.first_replicate, plan.first_replicate + plan.replicates - 1
    return [
        (f"{word}s", ", ".join(short_names(plan.rocks))),
        ("conditions", ", ".join(condition.name for condition in plan.conditions)),
        ("replicates", f"{first} to {last}" if last > first else str(first)),
        ("mission preset", ", ".join(sorted({config.preset for config in plan.strategies.values()}))),
        *recorded_rows(recorded([r.record.directory for r in run.records])),
    ]
