"""What is compared: a campaign's recommendation on unseen rocks or on its own, and the paper's strategies for Table I."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from nbv.config import IDEAL_CONDITION, PRESETS, Condition, MissionConfig
from nbv.errors import UserError
from nbv.mission.result import Keep
from tuner.campaign.begin import learn_from
from tuner.campaign.campaign import Campaign
from tuner.campaign.mission_problem import Evaluated, rock_arguments
from tuner.campaign.settings import CampaignSettings
from tuner.comparison.plan import (
    EvaluationEvent,
    EvaluationPlan,
    EvaluationRun,
    evaluation_directory,
    run_evaluation,
)
from tuner.missions.pool import Executor
from tuner.missions.registry import DEFAULT_FIDELITY, mission_kind
from tuner.problem.baselines import (
    ANSWERS,
    COMPARISON,
    REPRODUCTION_STRATEGIES,
    baseline_configs,
    label,
    reference_of,
)
from tuner.problem.goal import Goal, Objective
from tuner.problem.search_space import TUNED
from tuner.recommendation.recommendation import Recommendation

AT_THE_END = 1  # replicates of the comparison that a campaign ends in
EVALUATION, CONFIRMATION = "evaluation", "confirmation"  # where a campaign's comparisons lie
TABLE_I = Goal(Objective("whole.completeness_48mm"))


@dataclass(frozen=True)
class PlannedComparison:
    plan: EvaluationPlan
    reference: str  # the strategy that differences are from
    title: str
    usual: Path  # its directory, unless the user names another
    notes: tuple[str, ...] = ()  # what a reader must know before the outcome
    goal: Goal = TABLE_I
    source: Campaign | None = None  # None: the paper's Table I

    def not_counted(self, out: Path | None) -> str:
        """Return why what runs in ``out`` (None: in ``usual``) adds nothing to its campaign's answer; empty where it does."""
        if self.source is None:
            return ""
        begin, usual = "This does not count toward the campaign's answer", self.usual.resolve()
        if out is not None and (
            out.resolve().parent != usual.parent or not out.resolve().name.startswith(usual.name)
        ):
            return f"{begin}, which reads {self.usual}, {self.usual.name}-2 and so on, not {out}."
        own = [condition.name for condition in self.source.settings.conditions]
        if not any(condition.name in own for condition in self.plan.conditions):
            return f"{begin}, which is for {', '.join(own)}, where it was tuned."
        return ""

    def run(
        self,
        executor: Executor,
        on_event: Callable[[EvaluationEvent], None] | None = None,
        out: Path | None = None,
    ) -> EvaluationRun:
        """Run what is missing in ``out``, else in ``usual`` or, where that holds another plan, in a directory beside it."""
        directory = out or evaluation_directory(self.plan, self.usual)
        return run_evaluation(self.plan, directory, executor, on_event)


def held_out(
    source: Campaign,
    *,
    rocks: Sequence[str] | None = None,
    replicates: int = 3,
    strategies: Sequence[str] | None = None,
    conditions: Sequence[Condition] | None = None,
    fidelity: str = DEFAULT_FIDELITY,
) -> PlannedComparison:
    """The recommendation and the baselines on rocks that the campaign has not seen.

    Raises `UserError`: no mission has succeeded, a rock was tuned on, a name is unknown, a condition contradicts the
    campaign.
    """
    s, found = source.settings, source.recommended()
    under = tuple(conditions or s.conditions)
    dataclasses.replace(s, conditions=under)  # says where the two contradict each other
    s.problem.strategies(_evaluated(source, found, under, ()), strategies)  # names, before rocks take minutes
    chosen = source.evaluation_rocks(rocks)
    tuned = _evaluated(source, found, under, chosen)
    plan, notes = _against_baselines(s, tuned, strategies, replicates, fidelity)
    against = reference_of([name for name in plan.strategies if name not in ANSWERS], s.problem.reference)
    notes = (*_notes(found), *notes)
    title = f"{s.name}: tuned against baselines on held-out targets"
    return PlannedComparison(plan, against, title, source.directory / EVALUATION, notes, s.goal, source)


def _against_baselines(
    s: CampaignSettings, tuned: Evaluated, names: Sequence[str] | None, replicates: int, fidelity: str
) -> tuple[EvaluationPlan, tuple[str, ...]]:
    configs, notes = s.problem.strategies(tuned, names)
    conditions = tuple(tuned.conditions)
    plan = EvaluationPlan(configs, tuple(tuned.rocks), replicates, fidelity=fidelity, conditions=conditions)
    return plan, notes


def confirmation(
    source: Campaign,
    *,
    rocks: Sequence[str] | None = None,
    replicates: int = 4,
    fidelity: str = DEFAULT_FIDELITY,
) -> PlannedComparison | None:
    """The tuned configurations, the default and plain orbits on training rocks with fresh replicates; None where nothing is tuned.

    Raises `UserError`: no mission has succeeded; a rock was not tuned on.
    """
    s = source.settings
    known = {Path(rock).stem if os.sep in rock else rock: rock for rock in s.rocks}
    chosen = tuple(rock if rock in s.rocks else known.get(Path(rock).stem, rock) for rock in rocks or s.rocks)
    for rock in chosen:
        if rock not in s.rocks:
            raise UserError(
                f"{source.directory} was not tuned on {rock!r}; name one of {', '.join(known)}, or use evaluate"
            )
    found = source.recommended()
    if all(best.keep_default for best in found.values()):
        return None
    configs, notes = s.problem.controls(_evaluated(source, found, s.conditions, chosen))
    # Replicates that nothing has run.
    first = max([s.problem.replicates, *(trial.replicate + 1 for trial in source.trials())])
    plan = EvaluationPlan(
        configs, chosen, replicates, first_replicate=first, fidelity=fidelity, conditions=s.conditions
    )
    reference = reference_of([name for name in configs if name not in ANSWERS], s.problem.reference)
    title = f"{s.name}: tuned against baselines on training targets, fresh replicates"
    usual = source.directory / CONFIRMATION
    return PlannedComparison(plan, reference, title, usual, (*_notes(found), *notes), s.goal, source)


def reproduction(
    base: MissionConfig,
    rocks: Sequence[str],
    *,
    strategies: Sequence[str] | None = None,
    replicates: int = 1,
    conditions: Sequence[Condition] = (IDEAL_CONDITION,),
    fidelity: str = DEFAULT_FIDELITY,
    keep: Keep = "summary",
) -> PlannedComparison:
    """The paper's Table I: strategies, by default `REPRODUCTION_STRATEGIES`, that differ from ``base`` in nothing else.

    Raises `UserError`: a strategy or a rock is unknown.
    """
    configs = baseline_configs(list(strategies or REPRODUCTION_STRATEGIES), base)
    plan = EvaluationPlan(
        configs,
        tuple(rock_arguments(rocks)),
        replicates,
        fidelity=fidelity,
        keep=keep,
        conditions=tuple(conditions),
    )
    kind = mission_kind(fidelity)
    how = kind.numbers_are if kind.predicts else PRESETS[base.preset].purpose
    return PlannedComparison(
        plan,
        reference_of(configs, "hyb-h"),
        f"Table I reproduced with preset {base.preset}: {how}",
        Path("runs/reproduce"),
    )


def end_of_campaign(source: Campaign) -> PlannedComparison | None:
    """The comparison on held-out rocks that a campaign ends in where it has ``compare_on``."""
    s = source.settings
    if not s.compare_on:
        return None
    return held_out(
        source, rocks=s.compare_on, replicates=AT_THE_END, strategies=COMPARISON, fidelity=s.fidelity
    )


def require_comparable(s: CampaignSettings) -> None:
    """Raise `UserError` where the comparison that a campaign is to end in cannot run: better now than after its missions.

    Every plain plan is tried in the place of the recommendation, the default among them.
    """
    if not s.compare_on:
        return
    rocks = tuple(rock_arguments(s.compare_on))
    if s.learn_from:
        learned = learn_from(s.learn_from, s.problem, s.objective)
        if seen := {*learned.rocks, *learned.seen} & set(rocks):
            raise UserError(
                f"{sorted(seen)[0]} is compared on, and what the campaign learns from was tuned on it; compare on another rock, "
                "or leave --learn-from out"
            )
    for values in s.problem.arms.values():
        tuned = Evaluated({TUNED: values}, None, s.conditions, rocks)
        plan, _ = _against_baselines(s, tuned, COMPARISON, AT_THE_END, s.fidelity)
        plan.require_runnable()


def _evaluated(
    source: Campaign,
    found: Mapping[str, Recommendation],
    conditions: Sequence[Condition],
    rocks: Sequence[str],
) -> Evaluated:
    values = {name: best.values for name, best in found.items()}
    return Evaluated(values, source.mean_photographs(list(values.values())[-1]), conditions, rocks)


def _notes(found: Mapping[str, Recommendation]) -> tuple[str, ...]:
    """What a reader of the outcome must know of the recommendations."""
    notes = [
        f"{label(name)} is the default: nothing was found to be better."
        for name, best in found.items()
        if best.keep_default
    ]
    notes += [
        f"Nothing that the campaign ran is known to meet its constraint: {label(name)} comes nearest to it, with probability "
        f"{limit.probability:.0%}."
        for name, best in found.items()
        if (limit := best.missed) is not None
    ]
    return tuple(notes)
