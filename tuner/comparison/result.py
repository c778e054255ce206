"""What strategies that ran against each other have: tables, and verdicts with their numbers.

`tuner.report.comparison` puts these into words, for terminal, pages and JSON.
"""

from __future__ import annotations

import collections
import dataclasses
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

from tuner.campaign.campaign import Campaign
from tuner.campaign.settings import CampaignSettings
from tuner.comparison.of_campaign import HELD_OUT, MARGIN, TRAINING, PlannedComparison, evaluations
from tuner.comparison.run import EvaluationRun
from tuner.comparison.statistics import (
    TABLE_I_ROWS,
    TABLE_I_ROWS_OBSERVABLE,
    ComparisonRow,
    ComparisonTable,
    MetricRow,
    comparison_table,
    same_photographs,
    share_kept,
)
from tuner.comparison.verdict import Kind, Verdict, best_by_gain, judge
from tuner.missions.job import Trial
from tuner.missions.registry import DEFAULT_FIDELITY
from tuner.problem.baselines import (
    B_AWARE,
    CHOICE,
    COVIS,
    PAPER_STRATEGIES,
    THRESHOLDS,
    TUNED,
    TUNED_POOL_HYB_H,
    TUNED_WEIGHTS,
    controls_at_equal_number,
    grouped,
    in_table_order,
)
from tuner.problem.goal import Goal
from tuner.problem.intervals import Interval
from tuner.problem.objective import COUNTS, Objective
from tuner.problem.observations import mission_key
from tuner.problem.search_space import Configuration
from tuner.recommendation.recommendation import Recommendation

LIMIT = "limit"  # key of the share of rocks that met the constraint
_COSTS = (
    MetricRow("", "photos", "costs.images", "", False, 0),
    MetricRow("", "flight", "costs.flight_time_s", "s", False, 0),
)
_QUALITY = (
    MetricRow("", "F 48", "observable.f_score_48mm", "%", True),
    MetricRow("", "F 80", "observable.f_score_80mm", "%", True),
    MetricRow("", "C 48", "observable.completeness_48mm", "%", True),
    MetricRow("", "C 80", "observable.completeness_80mm", "%", True),
    MetricRow("", "C2C", "observable.c2c_mean_mm", "mm", False),
)


def row_of(o: Objective) -> MetricRow:
    """A table row of any metric, which is labelled and rounded where it is shown."""
    return MetricRow("", "", o.metric, "", o.direction == "maximise", None)


def by_strategy(
    records: Sequence[Trial], strategies: Sequence[str], reference: str, goal: Goal
) -> ComparisonTable:
    """Costs, the objectives, the usual measures of a cloud, and the share of rocks that met the constraint.

    What no mission has is left out. Missions of a mission file have their own costs.
    """
    objectives = [row_of(o) for o in (goal.shown, *goal.objectives)]
    if not any("images" in r.costs for r in records):
        costs = sorted({f"costs.{name}" for r in records for name in r.costs})
        objectives += [row_of(Objective(name, "minimise")) for name in costs]
    rows = {row.key: row for row in (*_COSTS, *objectives)} | {row.key: row for row in (*_COSTS, *_QUALITY)}
    table = comparison_table(records, strategies, reference, list(rows.values()))
    shown = [row for row in table.rows if any(row.cells.values())]
    if goal.limit is not None:
        shares = {name: kept_by(records, name, goal) for name in strategies}
        most = max((share.mean for share in shares.values() if share is not None), default=0.0)
        best = tuple(name for name, share in shares.items() if share is not None and share.mean == most)
        shown.append(ComparisonRow(MetricRow("", "", LIMIT, "%", True, 0), shares, best, None, {}))
    return dataclasses.replace(table, rows=shown)


def kept_by(records: Sequence[Trial], strategy: str, goal: Goal) -> Interval | None:
    assert goal.second is not None and goal.limit is not None
    return share_kept(records, strategy, goal.second, goal.limit)


class ComparisonFacts:
    """What a comparison found: tables, from the shortest to the longest, and verdicts."""

    def __init__(self, planned: PlannedComparison, run: EvaluationRun) -> None:
        self.planned, self.run = planned, run
        self.plan, self.records = run.plan, run.records
        self.reference, self.goal, self.word = planned.reference, planned.goal, planned.word
        self.strategies = tuple(in_table_order(self.plan.strategies))

    @cached_property
    def tables(self) -> dict[str, ComparisonTable]:
        """Table I by surface; empty where no mission has those metrics, as those of a mission file."""
        rows = {"whole": TABLE_I_ROWS, "observable": TABLE_I_ROWS_OBSERVABLE}
        return {
            name: comparison_table(self.records, self.strategies, self.reference, of)
            for name, of in rows.items()
            if any("whole" in r.metrics for r in self.records)
        }

    @cached_property
    def summary(self) -> ComparisonTable:
        """All strategies over all conditions."""
        return by_strategy(self.records, self.strategies, self.reference, self.goal)

    @cached_property
    def conditions(self) -> dict[str, ComparisonTable]:
        """The same, condition by condition; empty where there is one."""
        names = [c.name for c in self.plan.conditions]
        return {
            name: by_strategy(
                [r for r in self.records if r.condition == name], self.strategies, self.reference, self.goal
            )
            for name in names
            if len(names) > 1
        }

    @cached_property
    def verdicts(self) -> list[Verdict]:
        """On the tuned strategy, without one on the first that is not the reference, metric by metric."""
        goal, reference = self.goal, self.reference
        others = [name for name in self.plan.strategies if name != reference]
        if not others:
            return []
        subjects = [TUNED if TUNED in others else others[0]]
        if TUNED not in others and reference in PAPER_STRATEGIES:
            subjects = [name for name in others if name in PAPER_STRATEGIES] or subjects
        out = list[Verdict]()
        for name in subjects:
            if self.plan.owners[name] == self.plan.owners[reference]:
                continue
            if same_photographs(self.records, (reference, name)):
                out.append(Verdict(Kind.SAME, name, reference, goal.shown.metric, None))
                continue
            out += [judge(self.records, name, reference, o) for o in goal.objectives if o.metric in COUNTS]
            if goal.quality is not None:
                margin = 0.0 if goal.limit is None else MARGIN
                out.append(judge(self.records, name, reference, goal.quality, margin))
        if subjects == [TUNED] and goal.limit is not None and goal.second is not None:
            share = kept_by(self.records, TUNED, goal)
            if share is not None:
                kind = {100.0: Kind.KEPT, 0.0: Kind.NOT_KEPT}.get(share.mean, Kind.PARTLY_KEPT)
                out.append(Verdict(kind, TUNED, "", goal.second.metric, share))
        if subjects == [TUNED] and goal.quality is not None:
            out += self._best_control(goal.quality)
        return out

    def _best_control(self, quality: Objective) -> list[Verdict]:
        """Against the best control with as many photographs, other than the reference; empty if none was run."""
        names = [name for name in controls_at_equal_number(self.plan.strategies) if name != self.reference]
        best = best_by_gain(self.records, names, TUNED, quality)
        if not best:
            return []
        verdict = judge(self.records, TUNED, best, quality)
        return [dataclasses.replace(verdict, best_control=True)]


@dataclass(frozen=True)
class Results:
    """Every record of the present recommendation and of what it is compared with, on held-out or on training instances."""

    held_out: bool
    records: list[Trial]
    strategies: Mapping[str, Configuration]
    complete: bool
    settings: CampaignSettings  # of the campaign

    @property
    def reference(self) -> str:
        return self.settings.problem.reference

    @cached_property
    def table(self) -> ComparisonTable:
        return by_strategy(self.records, in_table_order(self.strategies), self.reference, self.settings.goal)

    def gain(self, strategy: str) -> Interval | None:
        """The paired gain over the reference, positive where it is better."""
        return judge(self.records, strategy, self.reference, self.settings.goal.shown).gain

    @property
    def rocks(self) -> tuple[str, ...]:
        """The rocks, or a mission file's instances, on which the recommendation has run."""
        return tuple(dict.fromkeys(r.rock for r in self.records if r.strategy == TUNED))

    @property
    def replicates(self) -> list[int]:
        """How many replicates the recommendation has on each of these."""
        blocks = {(r.rock, r.condition, r.replicate) for r in self.records if r.strategy == TUNED}
        return sorted(collections.Counter(rock for rock, _, _ in blocks).values())


def held_out_results(campaign: Campaign, tuned: Configuration) -> Results | None:
    """Return the evaluations of ``tuned`` under the campaign's conditions, pooled; None without one.

    Missions with photographs count where there are some, else the others.
    """
    plans = evaluations(campaign, HELD_OUT, tuned)
    if any(plan.fidelity == DEFAULT_FIDELITY for _, plan in plans):
        plans = [(where, plan) for where, plan in plans if plan.fidelity == DEFAULT_FIDELITY]
    under = {condition.name for condition in campaign.settings.conditions}
    records, strategies, complete = list[Trial](), dict[str, Configuration](), True
    for where, plan in plans:
        of_plan = plan.records(where)
        if counted := [r for r in of_plan if r.condition in under]:  # of one without, nothing is to be shown
            complete &= len(of_plan) == plan.combinations
            records += counted
            strategies |= plan.strategies
    records = _with_twins(records, strategies)
    return Results(True, records, strategies, complete, campaign.settings) if records else None


def training_results(campaign: Campaign, best: Recommendation) -> Results:
    """Return the campaign's trials of the recommendation and of the plain plans, with the records of confirmations."""
    s, trials = campaign.settings, campaign.trials()
    names: dict[str, Mapping[str, object]] = {TUNED: best.values, **s.problem.arms}
    records = [
        dataclasses.replace(t, strategy=name, rock=s.problem.drawn_rock(t.rock, t.replicate))
        for name, values in names.items()
        for t in trials
        if t.record.status and dict(t.values) == dict(values)
    ]
    configs = {name: s.problem.config(values) for name, values in names.items()}
    for where, plan in evaluations(campaign, TRAINING, configs[TUNED]):
        renamed = {
            name: next((n for n, c in configs.items() if mission_key(c) == mission_key(config)), name)
            for name, config in plan.strategies.items()
            if name != TUNED
        }
        records += [
            dataclasses.replace(r, strategy=renamed.get(r.strategy, r.strategy)) for r in plan.records(where)
        ]
    place = {rock: k for k, rock in enumerate(s.rocks)}
    records.sort(key=lambda r: place.get(r.rock, 0))
    return Results(False, _with_twins(records, configs), configs, True, s)


def _with_twins(records: Sequence[Trial], strategies: Mapping[str, Configuration]) -> list[Trial]:
    """Return each record once, those of the recommendation also under the names of the strategies that run its missions."""
    tuned, of_tuned = strategies.get(TUNED), [r for r in records if r.strategy == TUNED]
    same = [] if tuned is None else [n for n, c in strategies.items() if mission_key(c) == mission_key(tuned)]
    every = [*records, *(dataclasses.replace(r, strategy=name) for name in same for r in of_tuned)]
    return list({(r.strategy, r.rock, r.condition, r.replicate): r for r in every}.values())


def all_results(campaign: Campaign, best: Recommendation | None) -> list[Results]:
    """The strategies beside the recommendation, on held-out rocks first; empty without an evaluation."""
    s = campaign.settings
    held_out = None if best is None else held_out_results(campaign, s.problem.config(best.values))
    if best is None or held_out is None or held_out.reference not in held_out.strategies:
        return []
    training = training_results(campaign, best)
    return [held_out, training] if training.records else [held_out]


@dataclass(frozen=True)
class Step:
    """One part of the way from Hyb-H to the tuned configuration, by missions on the same rocks and replicates."""

    groups: list[str]  # of parameters, which this step changes
    strategy: str
    gain: Interval | None  # over the step before; None where the two have no mission in common


def measured_steps(
    records: Sequence[Trial],
    strategies: Collection[str],
    changed: Sequence[str],
    quality: Objective,
) -> list[Step]:
    """Return the gain over Hyb-H step by step: pool (with seeds and stop), weights, thresholds, as far as each was run."""
    groups = grouped(changed)
    elsewhere = [name for name in groups if name not in CHOICE]
    weights = [name for name in groups if name in (COVIS, B_AWARE)]
    thresholds = [name for name in groups if name == THRESHOLDS]
    stages = [(TUNED_POOL_HYB_H, elsewhere), (TUNED_WEIGHTS, weights), (TUNED, thresholds)]
    steps, before, waiting = list[Step](), "hyb-h", list[str]()
    for strategy, names in stages:
        waiting += names
        if strategy in strategies and waiting:
            gain = judge(records, strategy, before, quality).gain
            steps.append(Step(waiting, strategy, gain))
            before, waiting = strategy, []
    return steps
