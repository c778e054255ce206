"""Samplers that learn nothing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tuner.problem.observations import Observation, Proposal
from tuner.samplers.base import SamplerSettings, derived_seed, initial_proposal, missions_asked


@dataclass(frozen=True)
class PlainSampler:
    """A scrambled Sobol sequence, or uniform draws from the unit cube."""

    settings: SamplerSettings
    name: str  # sobol or random

    def ask(self, history: Sequence[Observation], pending: Sequence[Observation]) -> Proposal:
        s, number = self.settings, missions_asked(history, pending)
        if self.name == "sobol" or number < s.first:
            return initial_proposal(s, number, self.name)
        rng = np.random.default_rng(derived_seed(s.seed, number))
        space = s.problem.space
        values = space.from_unit(rng.random(space.dimension))
        return Proposal(values, {"sampler": self.name, "phase": "random"})
