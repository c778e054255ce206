"""Our sampler: a Gaussian process over configurations, rocks, conditions and blocks."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from tuner.acquisition.front import propose_for_front, two_models
from tuner.acquisition.propose import propose
from tuner.problem.blocks import next_block
from tuner.problem.observations import Observation, Pending, Proposal
from tuner.problem.worlds import rocks_of
from tuner.samplers.base import SamplerSettings, asks, derived_seed, initial_proposal
from tuner.samplers.design import near_default, places_for_earlier, sobol_point, stays_near_default
from tuner.samplers.verification import BEGINS, verification
from tuner.surrogate.forward_check import PREDICTED
from tuner.surrogate.model import RockMeanGP
from tuner.surrogate.settings import SurrogateSettings, surrogate_settings

MIN_FEASIBLE_FOR_MODEL = 2


@dataclass(frozen=True)
class GPSampler:
    """Default configuration, initial design, then log noisy expected improvement on the rock-mean GP.

    The design is a Sobol sequence; unless parameters are many every second point stays near a trusted default. Where
    missions were flown before the campaign, the best of them take places of it. Near the end of the budget the favourite
    is flown on blocks it has not seen, where that is worth more (``tuner.samplers.verification``).
    """

    settings: SamplerSettings
    name: str = "gp"
    model: SurrogateSettings | None = None  # of the surrogate; None: by the settings' options
    verify: bool = True

    def ask(self, history: Sequence[Observation], pending: Sequence[Pending]) -> Proposal:
        """The maximiser of the acquisition, or the next point of the initial design."""
        s, number = self.settings, asks(history, pending)
        feasible = [o for o in history if o.feasible]
        if number < s.initial or len(feasible) < MIN_FEASIBLE_FOR_MODEL:
            return self._design(number)
        seed = derived_seed(s.seed, number)
        flying = [p.values for p in pending]
        if s.two_objectives and sum(o.second is not None for o in feasible) >= MIN_FEASIBLE_FOR_MODEL:
            models = two_models(
                s.space, feasible, s.worlds, seed, self.model or surrogate_settings(s.space, s.risk)
            )
            values, figures = propose_for_front(models, flying, seed)
            return Proposal(values, {"sampler": self.name, "phase": "front", **figures})
        feature = None if s.earlier is None else s.earlier.feature
        own = self.model or surrogate_settings(s.space, s.risk)
        model = RockMeanGP(s.space, feasible, s.worlds, seed, own, feature)
        values, figures = propose(model, flying, seed, s.risk)
        if self.verify and s.budget is not None and number >= BEGINS * s.budget:
            gain, last = figures["expected_gain"], number >= s.budget - len(rocks_of(s.worlds)) * s.replicates
            again = verification(model, history, pending, s.replicates, gain, s.risk, last=last)
            if again is not None:
                return _predicted(model, dataclasses.replace(again, why={**figures, **again.why}))
        proposal = Proposal(values, {"sampler": self.name, "phase": "model", **figures})
        world, replicate = next_block(s.worlds, s.replicates, [*history, *pending], proposal)
        placed = dataclasses.replace(
            proposal, rock=world.rock, condition=world.condition, replicate=replicate
        )
        return _predicted(model, placed)

    def _design(self, number: int) -> Proposal:
        s, rank = self.settings, number // 2 - 1
        if number == 0:
            return initial_proposal(s, 0, self.name)
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


def _predicted(model: RockMeanGP, proposal: Proposal) -> Proposal:
    """With what the model predicts of the mission, so that it can be told how well it did."""
    assert proposal.world is not None
    mean, sd = model.predict_mission(proposal.values, proposal.world, proposal.replicate)
    return dataclasses.replace(proposal, memory={PREDICTED: [mean, sd]})


def make_gp_sampler(name: str, settings: SamplerSettings) -> GPSampler:
    """Our sampler."""
    return GPSampler(settings, name)
