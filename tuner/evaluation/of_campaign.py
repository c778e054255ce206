"""What is compared: a campaign's recommendation on unseen rocks or on its own, and the paper's strategies for Table I."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Collection, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from nbv.config import IDEAL, IDEAL_CONDITION, Condition, MissionConfig
from nbv.errors import UserError
from nbv.mission.function import Keep
from nbv.photographs import PhotographSet
from nbv.rocks.catalogue import are_photographed
from tuner.campaign.campaign import Campaign
from tuner.campaign.rock_choice import Making, rock_arguments
from tuner.campaign.settings import CampaignSettings
from tuner.evaluation.baselines import (
    COMPARISON,
    CONTROLS,
    EVALUATION_BASELINES,
    REAIMED_ORBITS,
    REPRODUCTION_STRATEGIES,
    TUNED,
    TUNED_POOL_HYB_H,
    TUNED_POOL_RANDOM,
    any_must_look,
    at_equal_number,
    baseline_configs,
    ending_at,
    is_orbit,
    kind_of,
    orbits_at_number,
    tuned_configs,
)
from tuner.evaluation.plan import EvaluationPlan
from tuner.missions.external.mission_file import external_config
from tuner.missions.registry import DEFAULT_FIDELITY, EXTERNAL
from tuner.problem.instances import are_drawn, held_out_rocks_of, with_families
from tuner.problem.objective import COUNTS, Objective
from tuner.problem.search_space import Configuration, builtin
from tuner.recommendation.recommendation import Recommendation

DEFAULT_MARGIN = 1.0  # percent points of F-score
HIGHEST_DEG = 60.0
HELD_OUT, TRAINING = "evaluation", "confirmation"  # where a campaign's comparisons lie


@dataclass(frozen=True)
class ComparisonSpec:
    """What strategies are compared in, and how much quality may be lost and still counts as kept."""

    objective: Objective
    second: Objective | None = None
    limit: float | None = None  # of the second, its unit
    margin: float = DEFAULT_MARGIN  # of the quality, its unit
    decided: frozenset[str] = frozenset(
        COUNTS
    )  # metrics that the configuration decides: they have no interval
    place: str = "rock"  # what missions are run on: rocks, or the instances of a mission file

    @property
    def counts(self) -> list[Objective]:
        """Those objectives that the configuration decides."""
        return [o for o in (self.objective, self.second) if o is not None and o.metric in self.decided]

    @property
    def quality(self) -> Objective | None:
        """The objective that missions decide; None where the configuration decides all."""
        both = (self.objective, self.second)
        return next((o for o in both if o is not None and o.metric not in self.decided), None)


@dataclass(frozen=True)
class CampaignEvaluation:
    """What is run, against what, in which metrics, and what to know before the outcome."""

    plan: EvaluationPlan
    reference: str
    asked: ComparisonSpec
    notes: tuple[str, ...] = ()


def held_out(
    source: Campaign,
    *,
    rocks: Sequence[str] | None = None,
    replicates: int = 3,
    strategies: Sequence[str] | None = None,
    conditions: Sequence[Condition] | None = None,
    fidelity: str = DEFAULT_FIDELITY,
    margin: float = DEFAULT_MARGIN,
    making: Making = nullcontext,
) -> CampaignEvaluation:
    """The recommendation and the baselines on rocks, or a mission file's instances, that the campaign has not seen.

    Raises
    ------
    UserError
        No mission has succeeded, a rock was tuned on, a name is unknown, a condition contradicts the campaign.
    """
    s, found = source.settings, source.recommended()
    recommended, notes = s.config(found.values), _notes(found)
    if s.mission is not None:
        if conditions:
            raise UserError("--condition is of our own missions; a mission file has instances")
        known = {"default": {}, **s.mission.baselines}
        for name in strategies or ():
            if name not in known:
                raise UserError(f"{s.mission.path} has no baseline {name!r}; there are {', '.join(known)}")
        configs: dict[str, Configuration] = {
            name: external_config(s.mission, known[name]) for name in strategies or known
        }
        against = _reference(configs, "default")
        evaluated = {TUNED: recommended, **configs}
        plan = EvaluationPlan(evaluated, _instances(s, rocks), replicates, fidelity=EXTERNAL)
        return CampaignEvaluation(plan, against, asked_of(s, margin), notes)
    instances = tuple(conditions or s.conditions)
    dataclasses.replace(s, conditions=instances)  # says where the two contradict each other
    looking = any_must_look(builtin(s.base_config()), _looking(instances, rocks or ()))
    names = tuple(strategies or (*EVALUATION_BASELINES, *(REAIMED_ORBITS if looking else ())))
    if not rocks and are_drawn(s.rocks):
        rocks = s.rocks
    if rocks and are_drawn(asked_rocks := with_families(rocks)):  # a replicate of a family is another rock
        rocks, replicates = held_out_rocks_of(asked_rocks, replicates), 1
    configs_of_ours, more = _against(source, found, names, instances, rocks or ())
    plan = EvaluationPlan(
        configs_of_ours,
        source.unseen_rocks(rocks, making),
        replicates,
        fidelity=fidelity,
        conditions=instances,
    )
    notes = (*notes, *more, *_conditions(source, instances))
    return CampaignEvaluation(plan, _reference(names, "hyb-h"), asked_of(s, margin), notes)


def confirmation(
    source: Campaign,
    *,
    rocks: Sequence[str] | None = None,
    replicates: int = 4,
    fidelity: str = DEFAULT_FIDELITY,
    margin: float = DEFAULT_MARGIN,
) -> CampaignEvaluation | None:
    """The recommendation, the default and plain orbits on training rocks with fresh replicates; None where the first two
    are one.

    Raises
    ------
    UserError
        No mission has succeeded; a rock was not tuned on.
    """
    s = source.settings
    known = {rock if s.mission is not None else Path(rock).stem: rock for rock in s.rocks}
    chosen = tuple(rock if rock in s.rocks else known.get(Path(rock).stem, rock) for rock in rocks or s.rocks)
    for rock in chosen:
        if rock not in s.rocks:
            raise UserError(
                f"{source.directory} was not tuned on {rock!r}; name one of {', '.join(known)}, or use evaluate"
            )
    found = source.recommended()
    if found.keep_default:
        return None
    tuned = s.config(found.values)
    orbits: dict[str, MissionConfig] = {}
    more: tuple[str, ...] = ()
    if s.mission is None:
        seen = _looking(s.conditions, chosen)
        orbits, more = where_photographed(orbits_at_number(_counted(source, found.values), seen), chosen)
    first = _first_fresh(source)
    if s.draws_rocks:
        chosen = tuple(s.rock_evaluated(rock, first + k) for k in range(replicates) for rock in chosen)
        first, replicates = 0, 1
    plan = EvaluationPlan(
        {TUNED: tuned, "default": s.config(s.default_values()), **orbits},
        chosen,
        replicates,
        first_replicate=first,
        fidelity=EXTERNAL if s.mission is not None else fidelity,
        conditions=s.conditions,
    )
    return CampaignEvaluation(plan, "default", asked_of(s, margin), (*_notes(found), *more))


def reproduction(
    base: MissionConfig,
    rocks: Sequence[str],
    *,
    strategies: Sequence[str] | None = None,
    replicates: int = 1,
    conditions: Sequence[Condition] = (IDEAL_CONDITION,),
    fidelity: str = DEFAULT_FIDELITY,
    keep: Keep = "summary",
    making: Making = nullcontext,
) -> CampaignEvaluation:
    """The paper's Table I: strategies, by default `REPRODUCTION_STRATEGIES`, that differ from ``base`` in nothing else.

    Raises
    ------
    UserError
        A strategy or a rock is unknown.
    """
    configs = baseline_configs(list(strategies or REPRODUCTION_STRATEGIES), base)
    plan = EvaluationPlan(
        configs,
        tuple(rock_arguments(rocks, making)),
        replicates,
        fidelity=fidelity,
        keep=keep,
        conditions=tuple(conditions),
    )
    return CampaignEvaluation(
        plan, _reference(configs, "hyb-h"), ComparisonSpec(Objective("whole.completeness_48mm"))
    )


def training_comparison(source: Campaign, replicates: int = 1) -> CampaignEvaluation:
    """The recommendation and the paper's strategies on the training rocks, with the replicates that the campaign has run.

    They show what was tuned for, at little cost: seeds, default and recommendation are known. `confirmation` has fresh
    replicates, and the controls are compared on the held-out rocks, where a gain counts.
    """
    s, found = source.settings, source.recommended()
    strategies, notes = _against(source, found, COMPARISON, s.conditions, s.rocks)
    kept = {
        name: c for name, c in strategies.items() if kind_of(name) != CONTROLS or name == TUNED_POOL_HYB_H
    }
    plan = EvaluationPlan(kept, s.rocks, replicates, fidelity=s.fidelity, conditions=s.conditions)
    return CampaignEvaluation(plan, _reference(strategies, "hyb-h"), asked_of(s), notes)


def end_of_campaign(source: Campaign, making: Making = nullcontext) -> dict[str, CampaignEvaluation]:
    """The comparisons that a campaign ends in where it has ``compare_on``, by directory: held-out rocks, training rocks."""
    s = source.settings
    if not s.compare_on:
        return {}
    unseen = held_out(
        source, rocks=s.compare_on, replicates=2, strategies=COMPARISON, fidelity=s.fidelity, making=making
    )
    return {HELD_OUT: unseen, TRAINING: training_comparison(source)}


def _against(
    source: Campaign,
    found: Recommendation,
    names: Sequence[str],
    conditions: Sequence[Condition],
    rocks: Sequence[str],
) -> tuple[dict[str, MissionConfig], tuple[str, ...]]:
    """The recommendation with the arms that split its gain, and baselines at its number of photographs; notes on them."""
    s = source.settings
    base, tuned, counted = (
        builtin(s.base_config()),
        builtin(s.config(found.values)),
        _counted(source, found.values),
    )
    baselines = baseline_configs(list(names), base)
    against = _reference(baselines, "hyb-h")
    controls, notes = where_photographed(at_equal_number(baselines, counted, against), rocks)
    arms = tuned_configs(tuned, base, counted)
    if not {"random", "hyb-h"} <= set(names):  # who names some strategies wants no others
        arms = {name: config for name, config in arms.items() if name in (TUNED, TUNED_POOL_RANDOM)}
    return {TUNED: arms.pop(TUNED), **controls, **arms}, notes


def _first_fresh(source: Campaign) -> int:
    """The first replicate that the campaign has not run anywhere."""
    return max([source.settings.blocks, *(trial.replicate + 1 for trial in source.trials())])


def _looking(conditions: Sequence[Condition], rocks: Sequence[str]) -> Sequence[Condition]:
    """The conditions under which a mission may have to look for its target: what was photographed stays where it was."""
    return () if are_photographed(rocks) else conditions


def _counted(source: Campaign, values: Mapping[str, Any]) -> MissionConfig:
    """The configuration with the number of photographs that it takes; the mean of its missions, rounded up, where they vary."""
    config = builtin(source.settings.config(values))
    if not config.stop.may_end_early:
        return config
    numbers = [t.costs["images"] for t in source.trials() if t.costs and dict(t.values) == dict(values)]
    return ending_at(config, math.ceil(sum(numbers) / len(numbers))) if numbers else config


def asked_of(settings: CampaignSettings, margin: float = DEFAULT_MARGIN) -> ComparisonSpec:
    """What the campaign was asked for."""
    exact = settings.exact
    computed = {cost.objective.metric for cost in (exact.first, exact.second) if cost is not None}
    decided = frozenset({*COUNTS, *computed})
    place = "rock" if settings.mission is None else "instance"
    return ComparisonSpec(settings.objective, settings.second, settings.limit, margin, decided, place)


def _reference(configs: Collection[str], usual: str) -> str:
    """What differences are taken against: the paper's default, or the first that is run."""
    return usual if usual in configs else next(iter(configs))


def _instances(settings: CampaignSettings, rocks: Sequence[str] | None) -> tuple[str, ...]:
    assert settings.mission is not None
    names, path = list(settings.mission.held_out), settings.mission.path
    if not names:
        raise UserError(f"{path} holds nothing out; name instances under held_out")
    for rock in rocks or ():
        if rock not in names:
            raise UserError(f"{rock!r} is not held out; {path} holds out {', '.join(names)}")
    return tuple(rocks or names)


def _notes(found: Recommendation) -> tuple[str, ...]:
    """What a reader of the outcome must know of the recommendation."""
    notes = []
    if found.keep_default:
        notes.append("The campaign recommends to keep the default: Tuned is the default.")
    if found.limit is not None and not found.limit.kept:
        notes.append(
            "Nothing that the campaign ran is known to keep its limit: Tuned is the likeliest to, with probability "
            f"{found.limit.probability:.0%}."
        )
    return tuple(notes)


def _conditions(source: Campaign, conditions: Sequence[Condition]) -> list[str]:
    """Which conditions the campaign, and those that it learned from, have run under."""
    evaluated = {condition.name for condition in source.settings.conditions}
    if source.learned is not None:
        evaluated |= {o.condition for o in source.learned.observations}
    names = [condition.name for condition in conditions]
    notes = []
    if unseen := [name for name in names if name not in evaluated]:
        notes.append(f"Conditions that the campaign has not seen: {', '.join(unseen)}.")
    if (seen := [name for name in names if name in evaluated]) and names != [IDEAL]:
        notes.append(f"Tuned under, so no test of transfer: {', '.join(seen)}.")
    return notes


def where_photographed(
    strategies: Mapping[str, MissionConfig], rocks: Sequence[str]
) -> tuple[dict[str, MissionConfig], tuple[str, ...]]:
    """``strategies`` whose plain orbits run where the photographs are, if all ``rocks`` are sets, and a note that says so.

    One ring runs at the median elevation of all photographs, two rings at their quartiles.
    """
    if not are_photographed(rocks) or not any(map(is_orbit, strategies)):
        return dict(strategies), ()
    elevations_deg = np.concatenate([PhotographSet.read(rock).coverage.elevations_deg for rock in rocks])
    low, middle, high = np.percentile(elevations_deg, [25, 50, 75]).clip(0.0, HIGHEST_DEG).round(1).tolist()

    def placed(config: MissionConfig) -> MissionConfig:
        one = config.seed.upper_share == 0
        ring = {"seed.lowest_deg": middle if one else low, "seed.span_deg": 0.0 if one else high - low}
        return config.with_values(ring)

    note = (
        f"Plain orbits run where the photographs were taken: one ring at {middle:g}° (the median), two at {low:g}° and "
        f"{high:g}° (the quartiles)."
    )
    return {name: placed(c) if is_orbit(name) else c for name, c in strategies.items()}, (note,)
