"""Our sampler: a Gaussian process over configurations, rocks, conditions and blocks."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from tuner.acquisition.constrained import Constraint, propose_constrained, surrogate_of
from tuner.acquisition.draws import draw
from tuner.acquisition.propose import propose
from tuner.acquisition.two_objectives import Outcome, two_models
from tuner.problem.blocks import next_block
from tuner.problem.exact_costs import PREDICTED_SECOND, Exact, ExactCost
from tuner.problem.observations import PREDICTED, Observation, Pending, Proposal
from tuner.problem.search_space import Values
from tuner.problem.worlds import rocks_of
from tuner.samplers.base import (
    VERIFICATION_BEGINS,
    SamplerSettings,
    derived_seed,
    in_flight,
    initial_proposal,
    missions_asked,
)
from tuner.samplers.design import near_default, places_for_earlier, sobol_point, stays_near_default
from tuner.samplers.verification import verification
from tuner.surrogate.known import KnownOutcome
from tuner.surrogate.model import RockMeanGP
from tuner.surrogate.settings import SurrogateSettings

MIN_FEASIBLE_FOR_MODEL = 2
ASIDE, MOST_SKIPPED = (
    1000,
    200,
)  # points of the design from beyond it, in place of those that break an exact limit
MAX_JOINT = (
    128  # missions in flight up to which an acquisition is asked: a proposal then takes a fifth of a second
)
SEQUENTIAL = (
    4  # of a batch; half of it where that is more and there is one objective. Drawn ones take no time
)


@dataclass(frozen=True)
class GPSampler:
    """Default configuration, initial design, then log noisy expected improvement on the rock-mean GP.

    The space's own beginnings come right after the default. The design is a Sobol sequence; unless parameters are many every second point stays near a trusted default. Where
    missions were flown before the campaign, the best of them take places of it. Near the end of the budget the favourite
    is flown on blocks it has not seen, where that is worth more (``tuner.samplers.verification``).
    """

    settings: SamplerSettings
    name: str = "gp"
    model: SurrogateSettings | None = None  # of the surrogate; None: by the number of parameters
    verify: bool = True

    def ask(self, history: Sequence[Observation], pending: Sequence[Pending]) -> Proposal:
        """Propose the maximiser of the acquisition, or the next point of the initial design."""
        return self.ask_many(history, pending, 1)[0]

    def ask_many(
        self, history: Sequence[Observation], pending: Sequence[Pending], count: int
    ) -> list[Proposal]:
        """Propose ``count`` missions by one model: half by the acquisition, each knowing those before; the others are drawn.

        With more in flight than `MAX_JOINT` all are drawn.
        """
        s, proposals, flying = self.settings, list[Proposal](), list(pending)
        feasible = [o for o in history if o.feasible]
        both = (
            s.at_least is not None and sum(o.second is not None for o in feasible) >= MIN_FEASIBLE_FOR_MODEL
        )
        exact = s.exact.agreed(history)
        models: tuple[Outcome, ...] = ()
        constraint: Constraint | None = None
        modelled, drawn, from_draws = 0, list[Values](), list[int]()
        while len(proposals) < count:
            number = missions_asked(history, flying)
            if number < s.initial or len(feasible) < MIN_FEASIBLE_FOR_MODEL:
                proposal = self._design(number, exact.second)
            else:
                if not models:
                    models = self._models(history, number, both, exact)
                    if both and s.at_least is not None:
                        constraint = Constraint(models[1], s.at_least, s.is_share)
                most = SEQUENTIAL if both else max(SEQUENTIAL, count // 2)
                if modelled < most and len(flying) <= MAX_JOINT:
                    proposal = self._by_acquisition(models, history, flying, number, constraint)
                else:
                    drawn = drawn or draw(
                        models, constraint, count - len(proposals), derived_seed(s.seed, number)
                    )
                    proposal = self._drawn(models, history, flying, number, drawn.pop(), constraint)
                    from_draws.append(len(proposals))
                modelled += 1
            proposals.append(proposal)
            flying.append(in_flight(s, history, flying, proposal))
        if from_draws:
            predicted = _predicted(models, [proposals[i] for i in from_draws])
            for i, proposal in zip(from_draws, predicted, strict=True):
                proposals[i] = proposal
        return proposals

    def _models(
        self, history: Sequence[Observation], number: int, both: bool, exact: Exact
    ) -> tuple[Outcome, ...]:
        """Return a surrogate of the objective, or a model of each of two."""
        s, seed = self.settings, derived_seed(self.settings.seed, number)
        if both:
            return two_models(s.space, history, s.worlds, seed, self.model, exact)
        return (RockMeanGP(s.space, history, s.worlds, seed, self.model),)

    def _by_acquisition(
        self,
        models: tuple[Outcome, ...],
        history: Sequence[Observation],
        flying: Sequence[Pending],
        number: int,
        constraint: Constraint | None = None,
    ) -> Proposal:
        s, configurations = self.settings, [p.values for p in flying]
        seed = derived_seed(s.seed, number)
        if constraint is None:
            values, figures = propose(surrogate_of(models), configurations, seed)
        else:
            values, figures = propose_constrained(models[0], constraint, configurations, seed)
        repeat = self._verified(models, history, flying, number, figures["expected_gain"], constraint)
        if repeat is not None:
            return _predicted(models, [dataclasses.replace(repeat, why={**figures, **repeat.why})])[0]
        proposal = Proposal(values, {"sampler": self.name, "phase": "model", **figures})
        return _predicted(models, [_placed(s, history, flying, proposal)])[0]

    def _drawn(
        self,
        models: tuple[Outcome, ...],
        history: Sequence[Observation],
        flying: Sequence[Pending],
        number: int,
        values: Values,
        constraint: Constraint | None,
    ) -> Proposal:
        repeat = self._verified(models, history, flying, number, math.inf, constraint)
        if repeat is not None:
            return repeat
        proposal = Proposal(values, {"sampler": self.name, "phase": "model", "drawn": True})
        return _placed(self.settings, history, flying, proposal)

    def _verified(
        self,
        models: tuple[Outcome, ...],
        history: Sequence[Observation],
        flying: Sequence[Pending],
        number: int,
        gain: float,
        constraint: Constraint | None = None,
    ) -> Proposal | None:
        s = self.settings
        if not self.verify or s.budget is None or number < VERIFICATION_BEGINS * s.budget:
            return None
        last = number >= s.budget - len(rocks_of(s.worlds)) * s.replicates
        model, exact = surrogate_of(models), models[0] if isinstance(models[0], KnownOutcome) else None
        return verification(
            model, history, flying, s.replicates, gain, last=last, constraint=constraint, exact=exact
        )

    def _design(self, number: int, limited: ExactCost | None) -> Proposal:
        """Return a mission of the design; unless it is the default, none that is known to break a limit of ``limited``."""
        if number == 0:
            return initial_proposal(self.settings, 0, self.name)
        skipped, least = 0, self.settings.at_least
        proposal = self._design_point(number)
        while limited is not None and least is not None and skipped < MOST_SKIPPED:
            if limited.outcome(proposal.values) >= least:
                return proposal
            skipped += 1
            proposal = self._design_point(number + 2 * ASIDE * skipped)
        return proposal

    def _design_point(self, number: int) -> Proposal:
        s, rank = self.settings, number // 2 - 1
        if 1 <= number <= len(s.space.begin):
            values = {**s.default, **s.space.begin[number - 1]}
            return Proposal(values, {"sampler": self.name, "phase": "begin"})
        places = places_for_earlier(s.initial)
        if number in places and s.earlier is not None and s.earlier.usable:
            place = places.index(number)
            best = s.earlier.best(place + 1)
            if len(best) > place:
                return Proposal(
                    best[place], {"sampler": self.name, "phase": "earlier missions", "rank": place}
                )
        if not stays_near_default(s.space.dimension, s.trusted_default):
            return initial_proposal(s, number, self.name)
        why: dict[str, Any] = {"sampler": self.name, "phase": "initial design"}
        if number % 2 == 1:
            values = near_default(s.space, s.default, s.seed, number // 2)
            return Proposal(values, {**why, "near": "default", "point": number // 2})
        return Proposal(sobol_point(s.space, s.seed, rank), {**why, "point": rank})


def _placed(
    s: SamplerSettings, history: Sequence[Observation], flying: Sequence[Pending], proposal: Proposal
) -> Proposal:
    world, replicate = next_block(s.worlds, s.replicates, [*history, *flying], proposal)
    return dataclasses.replace(proposal, rock=world.rock, condition=world.condition, replicate=replicate)


def _predicted(models: Sequence[Outcome], proposals: Sequence[Proposal]) -> list[Proposal]:
    """Return the proposals with what the surrogate predicts of them, so that its calibration can be checked later."""
    model = surrogate_of(models)
    key = PREDICTED if model is models[0] else PREDICTED_SECOND
    missions = [(p.values, p.world, p.replicate) for p in proposals if p.world is not None]
    return [
        dataclasses.replace(proposal, sampler_state={key: [mean, sd]})
        for proposal, (mean, sd) in zip(proposals, model.predict_missions(missions), strict=True)
    ]


def make_gp_sampler(name: str, settings: SamplerSettings) -> GPSampler:
    """Return our sampler."""
    return GPSampler(settings, name)
