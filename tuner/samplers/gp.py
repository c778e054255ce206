"""Sampler `gp`: a Gaussian process over configurations, rocks, conditions and blocks."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from tuner.acquisition.constrained import (
    Constraint,
    propose_constrained,
    thompson_configurations,
    two_models,
)
from tuner.acquisition.propose import propose
from tuner.problem.observations import Observation, Proposal, next_block
from tuner.problem.search_space import Region, Values
from tuner.recommendation.choose import JOINT, TOP
from tuner.samplers.base import (
    SamplerSettings,
    derived_seed,
    in_flight,
    initial_proposal,
    missions_asked,
    near_default,
    places_for_earlier,
    sobol_point,
    stays_near_default,
)
from tuner.surrogate.fit import numerics
from tuner.surrogate.model import InstanceMeanGP

# A configuration that ran once may not be recommended (``tuner.recommendation.choose``). Behind the budget the favourites
# therefore run where they have not (``tuner.campaign.session``); under a constraint they do so in its last third as well.


def verification(
    model: InstanceMeanGP,
    region: Region,
    history: Sequence[Observation],
    pending: Sequence[Observation],
    replicates: int,
    expected_gain: float,
    *,
    last: bool = False,
    constraint: Constraint | None = None,
    favourites: dict[str, Values | None] | None = None,
) -> Proposal | None:
    """Return the favourite on a block that it has not run, in an instance that it has run least; None where exploring is worth more.

    ``expected_gain``: what the best mission of the search promises, objective's unit, infinite where that is not known; exploring is
    worth more where that is more than the noise of a mission. ``last``: whether to verify whatever exploring promises.
    ``favourites``: those already known by this model, by region; this one is entered.
    """
    if expected_gain >= model.noise_sd and not last:
        return None
    favourites = {} if favourites is None else favourites
    if region.name not in favourites:
        favourites[region.name] = favourite_of(model, region, constraint)
    values = favourites[region.name]
    if values is None:
        return None
    missions: list[Observation] = [*history, *pending]
    evaluated = {(mission.instance, mission.replicate) for mission in missions if mission.values == values}
    counts = {
        instance: sum((instance, k) in evaluated for k in range(replicates)) for instance in model.instances
    }
    least = min(counts.values())
    if least >= replicates:
        return None
    fewest = [instance for instance, count in counts.items() if count == least]
    why = {"expected_gain": expected_gain} if math.isfinite(expected_gain) else {}
    proposal = Proposal(values, {"sampler": "gp", "phase": "verification", "region": region.name, **why})
    instance, replicate = next_block(fewest, replicates, missions, proposal)
    return dataclasses.replace(proposal, instance=instance, replicate=replicate)


def favourite_of(model: InstanceMeanGP, region: Region, constraint: Constraint | None) -> Values | None:
    """Return the configuration run in a region with the best posterior mean; None where none is taken to meet the constraint."""
    configurations = [v for v in model.configurations if region.contains(v)] or model.configurations
    if constraint is not None:
        configurations = [
            v for v, satisfied in zip(configurations, constraint.satisfied(configurations)) if satisfied
        ]
        if not configurations:
            return None
    if len(configurations) > JOINT:
        configurations = [configurations[i] for i in model.best_first(configurations)[:TOP]]
    return configurations[int(model.posterior(configurations).mean.argmax())]


MIN_FEASIBLE_FOR_MODEL = 2
ASIDE = 1000  # points of the sequence that the design does not reach
# After so many trials in a row without a new photograph the next one is drawn from the whole space.
REPEATS_BEFORE_EXPLORING = 4
# Missions in flight up to which an acquisition is asked: a proposal then takes a fifth of a second.
MAX_JOINT = 128
VERIFICATION_BEGINS = 2 / 3  # of the budget, under a constraint
# Of a batch; half of it where that is more and there is one objective. Drawn ones take no time.
SEQUENTIAL = 4


@dataclass(frozen=True)
class GPSampler:
    """The plain plans, initial design, then log noisy expected improvement on the rock-mean GP, over the best of a region.

    The regions whose best configurations are asked for take turns. The space's own beginnings come before the rest of the design.
    That is a Sobol sequence; unless parameters are many every second point of a region stays near a trusted default. Where missions
    were run before the campaign, the best of them take places of it.
    """

    settings: SamplerSettings
    name: str = "gp"

    def ask(self, history: Sequence[Observation], pending: Sequence[Observation]) -> Proposal:
        return self.ask_many(history, pending, 1)[0]

    @numerics()
    def ask_many(
        self, history: Sequence[Observation], pending: Sequence[Observation], count: int
    ) -> list[Proposal]:
        """Propose ``count`` missions by one model: half by the acquisition, each knowing those before; the others are drawn."""
        s, problem, proposals, running = self.settings, self.settings.problem, list[Proposal](), list(pending)
        feasible, at_least = [o for o in history if o.feasible], self.settings.goal.at_least
        both = at_least is not None and (
            sum(o.second is not None for o in feasible) >= MIN_FEASIBLE_FOR_MODEL
        )
        models: tuple[InstanceMeanGP, ...] = ()
        constraint: Constraint | None = None
        modelled, drawn, favourites = 0, list[Values](), dict[str, Values | None]()
        while len(proposals) < count:
            number = missions_asked(history, running)
            if number < s.initial or len(feasible) < MIN_FEASIBLE_FOR_MODEL:
                if number < s.first:
                    proposal = initial_proposal(s, number, self.name)
                else:
                    proposal = self._design_point(number - s.first + 1, history)
            elif all(o.repeat for o in history[-REPEATS_BEFORE_EXPLORING:]):
                metadata = {"sampler": self.name, "phase": "exploration"}
                proposal = Proposal(sobol_point(problem.space, s.seed, ASIDE + number), metadata)
            else:
                seed = derived_seed(s.seed, number)
                region = self._region(number)
                if not models and both and at_least is not None:
                    models = two_models(problem, history)
                    constraint = Constraint(models[1], at_least)
                elif not models:
                    models = (InstanceMeanGP(problem.space, history, problem.instances),)
                most = SEQUENTIAL if both else max(SEQUENTIAL, count // 2)
                configurations = [p.values for p in running]
                if modelled >= most or len(running) > MAX_JOINT:
                    drawn = drawn or thompson_configurations(models, constraint, count - len(proposals), seed)
                    values, gain = drawn.pop(), math.inf
                elif constraint is None:
                    values, gain = propose(models[0], configurations, seed, region)
                else:
                    values, gain = propose_constrained(models[0], constraint, configurations, seed)
                modelled += 1
                why = {"expected_gain": gain} if math.isfinite(gain) else {"drawn": True}
                proposal = self._verified(models, constraint, history, running, gain, favourites) or Proposal(
                    values, {"sampler": self.name, "phase": "model", "region": region.name, **why}
                )
            proposals.append(proposal)
            running.append(in_flight(s, history, running, proposal))
        return proposals

    def _region(self, number: int) -> Region:
        """Return whose turn it is; another one's with every round over the instances, so that each meets all of them."""
        problem = self.settings.problem
        return problem.answers[(number + number // len(problem.instances)) % len(problem.answers)]

    def _verified(
        self,
        models: tuple[InstanceMeanGP, ...],
        constraint: Constraint | None,
        history: Sequence[Observation],
        running: Sequence[Observation],
        gain: float,
        favourites: dict[str, Values | None],
    ) -> Proposal | None:
        """Return the favourite once more, in the last third of a budget under a constraint, where that is worth more than ``gain``."""
        s, problem = self.settings, self.settings.problem
        number = missions_asked(history, running) - sum(o.repeat for o in history)
        if s.budget is None or constraint is None or number < VERIFICATION_BEGINS * s.budget:
            return None
        return verification(
            models[0],
            problem.answers[-1],
            history,
            running,
            problem.replicates,
            gain,
            last=number >= s.budget - len(problem.rocks) * problem.replicates,
            constraint=constraint,
            favourites=favourites,
        )

    def _design_point(self, number: int, history: Sequence[Observation]) -> Proposal:
        """Return point ``number`` of the design, which begins with 1 behind the plain plans; the regions take turns."""
        s, problem = self.settings, self.settings.problem
        space, length = problem.space, s.initial - s.first + 1
        # Beginnings leave a place to the best earlier mission.
        begin = space.begin if s.earlier is None else space.begin[: max(0, length - 2)]
        if 1 <= number <= len(begin):
            values = space.settled({**problem.default, **begin[number - 1]})
            return Proposal(values, {"sampler": self.name, "phase": "begin"})
        places = places_for_earlier(length, len(begin))
        if number in places and s.earlier is not None:
            nth = places.index(number)
            best = s.earlier.best(nth + 1)
            if len(best) > nth:
                return Proposal(best[nth], {"sampler": self.name, "phase": "earlier missions", "rank": nth})
        metadata: dict[str, Any] = {"sampler": self.name, "phase": "initial design", "point": number}
        # The default with each other choice of a categorical parameter: Sobol points change everything at once.
        others = [
            space.settled({**problem.default, p.path: choice})
            for p in space.parameters
            for choice in p.choices
            if choice != problem.default[p.path]
        ]
        choices = [values for values in others if values != problem.default][: length // 3]
        if 0 <= (nth := number - len(begin) - 1) < len(choices) and s.earlier is None:
            return Proposal(choices[nth], metadata)
        region = self._region(number)
        near = len(problem.answers) == 1 and stays_near_default(space.dimension, s.trusted_default)
        if near and number % 2 == 1:
            values = near_default(space, problem.default, s.seed, number)
            metadata["near"] = "default"
        else:
            values = sobol_point(space, s.seed, number // 2 - 1 if near else number - 1)
        return Proposal(
            space.from_unit(region.project(space.to_unit(values))), {**metadata, "region": region.name}
        )
