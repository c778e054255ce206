"""Samplers that learn nothing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tuner.problem.observations import Observation, Proposal
from tuner.samplers.base import SamplerSettings, derived_seed, initial_proposal, missions_asked


@dataclass(frozen=True)
class SobolSampler:
    """Scrambled Sobol sequence."""

    settings: SamplerSettings
    name: str = "sobol"

    def ask(self, history: Sequence[Observation], pending: Sequence[Observation]) -> Proposal:
        return initial_proposal(self.settings, missions_asked(history, pending), self.name)


@dataclass(frozen=True)
class RandomSampler:
    """Uniform in the unit cube."""

    settings: SamplerSettings
    name: str = "random"

    def ask(self, history: Sequence[Observation], pending: Sequence[Observation]) -> Proposal:
        number = missions_asked(history, pending)
        if number < self.settings.defaults:
            return initial_proposal(self.settings, number, self.name)
        rng = np.random.default_rng(derived_seed(self.settings.seed, number))
        values = self.settings.space.from_unit(rng.random(self.settings.space.dimension))
        return Proposal(values, {"sampler": self.name, "phase": "random"})
