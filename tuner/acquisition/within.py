"""The best of one objective within a limit of another: what to fly next, and which configurations keep the limit."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from botorch.acquisition.logei import qLogNoisyExpectedImprovement
from botorch.acquisition.objective import GenericMCObjective
from botorch.models import ModelListGP
from botorch.sampling import SobolQMCNormalSampler

from nbv.types import Floats
from tuner.acquisition.propose import LOCAL_BEST, MONTE_CARLO_SAMPLES, maximise
from tuner.problem.search_space import Values
from tuner.surrogate.forward_check import Calibration
from tuner.surrogate.known import KnownOutcome
from tuner.surrogate.model import RockMeanGP, moments
from tuner.surrogate.numerics import numerics

SURE = 0.8  # probability from which on a configuration is taken to keep the limit
CALIBRATED = Calibration(np.zeros(0))
_CHUNK = 64


@dataclass(frozen=True)
class Within:
    """A limit of the second objective's mean over the training worlds."""

    model: RockMeanGP | KnownOutcome  # of what has the limit
    at_least: float  # oriented so that larger is better

    def belief(self, configurations: Sequence[Mapping[str, Any]]) -> tuple[Floats, Floats]:
        """(m,) means and standard deviations of the second objective, larger is better."""
        found = [
            self.model.posterior(configurations[i : i + _CHUNK])
            for i in range(0, len(configurations), _CHUNK)
        ]
        return np.concatenate([b.mean for b in found]), np.concatenate([b.sd for b in found])

    def probability(self, configurations: Sequence[Mapping[str, Any]]) -> Floats:
        """(m,) that each keeps the limit."""
        mean, sd = self.belief(configurations)
        return np.array(
            [CALIBRATED.probability_positive(m - self.at_least, max(s, 1e-9)) for m, s in zip(mean, sd)]
        )

    def keeps(self, configurations: Sequence[Mapping[str, Any]]) -> list[bool]:
        """Whether each can be taken to keep the limit."""
        return [bool(p >= SURE) for p in self.probability(configurations)] if configurations else []

    def floor(self, first: RockMeanGP) -> float:
        """The limit on the second model's common landscape, whose offsets belong to the limit."""
        second, unit = self.model, np.unique(first.unit, axis=0)
        assert isinstance(second, RockMeanGP)
        mean, _ = self.belief([first.space.from_unit(u) for u in unit])
        with torch.no_grad():
            level, _ = moments(second.model.posterior(first.inputs(unit)))
        return (self.at_least - float(np.mean(mean - second.mean_scale * level))) / second.mean_scale

    def promising(self, first: RockMeanGP) -> Floats:
        """(few, d) unit positions flown: the best of the first objective that may keep the limit, else the likeliest to."""
        unit = np.unique(first.unit, axis=0)
        chance = self.probability([first.space.from_unit(u) for u in unit])
        with torch.no_grad():
            own, _ = moments(first.model.posterior(first.inputs(unit)))
        order = np.lexsort((-own, chance < 0.5)) if (chance >= 0.5).any() else np.argsort(-chance)
        found: Floats = unit[order[:LOCAL_BEST]]
        return found


def propose_within(
    first: RockMeanGP, within: Within, pending: Sequence[Mapping[str, Any]], seed: int
) -> tuple[Values, dict[str, float]]:
    """The configuration with the largest log noisy expected improvement among those that keep the limit.

    The improvement counts by the probability of keeping the limit (Gardner et al., ICML 2014, in BoTorch's logarithmic
    form); before anything keeps it, the search is for what does.
    """
    second = within.model
    assert isinstance(second, RockMeanGP)
    with numerics(seed):
        unit = np.unique(first.unit, axis=0)
        baseline = first.inputs(unit)
        floor = within.floor(first)
        acquisition = qLogNoisyExpectedImprovement(
            ModelListGP(first.model, second.model),
            X_baseline=baseline,
            sampler=SobolQMCNormalSampler(torch.Size([MONTE_CARLO_SAMPLES]), seed=seed),
            objective=GenericMCObjective(lambda samples, X=None: samples[..., 0]),
            constraints=[lambda samples: floor - samples[..., 1]],
            X_pending=first.inputs(np.array([first.space.to_unit(v) for v in pending])) if pending else None,
            prune_baseline=True,
            cache_root=False,
        )
        position, score = maximise(first, acquisition, seed, near=within.promising(first))
    values = first.space.from_unit(position)
    return values, {
        "log_nei": score,
        "expected_gain": math.exp(score) * first.mean_scale,
        "probability_within": float(within.probability([values])[0]),
    }
