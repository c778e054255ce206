"""Optimisation under an outcome constraint on a second objective: what to run next, and which configurations meet it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from botorch.acquisition import AcquisitionFunction
from botorch.acquisition.logei import qLogNoisyExpectedImprovement
from botorch.acquisition.objective import GenericMCObjective
from botorch.models import ModelListGP
from botorch.sampling import SobolQMCNormalSampler

from nbv.types import Floats
from tuner.acquisition.propose import LOCAL_BEST, MONTE_CARLO_SAMPLES, maximise, noisy_improvement
from tuner.problem.goal import with_second_first
from tuner.problem.observations import Observation
from tuner.problem.problem import Problem
from tuner.problem.search_space import Values
from tuner.surrogate.model import InstanceMeanGP, moments
from tuner.surrogate.numerics import numerics, pruned
from tuner.surrogate.posterior import probability_positive

_CHUNK = 64
SURE = 0.8  # probability from which on a configuration is taken to meet a constraint
HOPELESS = 0.05  # probability of meeting the constraint


def two_models(
    problem: Problem, observations: Sequence[Observation], sparse: bool | None = None
) -> tuple[InstanceMeanGP, InstanceMeanGP]:
    """Return a model of each objective, on the missions that have both outcomes or failed.

    ``ValueError`` means that there are no such missions.
    """
    both = [o for o in observations if o.outcome is None or o.second is not None]
    return (
        InstanceMeanGP(problem.space, both, problem.instances, sparse=sparse),
        second_model(problem, observations, sparse),
    )


def second_model(
    problem: Problem, observations: Sequence[Observation], sparse: bool | None = None
) -> InstanceMeanGP:
    """Return the model of the second objective, as `two_models`."""
    return InstanceMeanGP(problem.space, with_second_first(observations), problem.instances, sparse=sparse)


@dataclass(frozen=True)
class Constraint:
    """A lower limit on the second objective's mean over the training instances."""

    model: InstanceMeanGP  # of the second objective
    at_least: float  # oriented so that larger is better

    def means_and_sds(self, configurations: Sequence[Mapping[str, Any]]) -> tuple[Floats, Floats]:
        """Return (m,) means and standard deviations of the second objective, larger is better."""
        beliefs = [
            self.model.posterior(configurations[i : i + _CHUNK])
            for i in range(0, len(configurations), _CHUNK)
        ]
        return np.concatenate([b.mean for b in beliefs]), np.concatenate([b.sd for b in beliefs])

    def probability(self, configurations: Sequence[Mapping[str, Any]]) -> Floats:
        """Return (m,) probabilities that each meets the constraint."""
        mean, sd = self.means_and_sds(configurations)
        sd = np.maximum(sd, 1e-9 * self.model.mean_scale)
        return np.array([probability_positive(m - self.at_least, s) for m, s in zip(mean, sd)])

    def keeps(self, configurations: Sequence[Mapping[str, Any]]) -> list[bool]:
        """Return whether each can be taken to meet the constraint."""
        return [bool(p >= SURE) for p in self.probability(configurations)] if configurations else []

    def floor(self) -> float:
        """Return the limit on the model's common landscape, whose offsets belong to the limit."""
        model = self.model
        unit, configurations = model.evaluated
        mean, _ = self.means_and_sds(configurations)
        with torch.no_grad():
            level, _ = moments(model.model.posterior(model.inputs(unit)))
        return (self.at_least - float(np.mean(mean - model.mean_scale * level))) / model.mean_scale

    def is_hopeless(self) -> bool:
        """Whether nothing that was run has a chance to meet the constraint, which only missions show."""
        return bool((self.probability(self.model.evaluated[1]) < HOPELESS).all())

    def promising(self, first: InstanceMeanGP) -> Floats:
        """Return (few, d) unit positions run: the best that may meet the constraint, else those nearest to it."""
        unit, configurations = self.model.evaluated
        chance = self.probability(configurations)
        with torch.no_grad():
            means, _ = moments(first.model.posterior(first.inputs(unit)))
        nearest = -self.means_and_sds(configurations)[0]
        order = np.lexsort((-means, chance < 0.5)) if (chance >= 0.5).any() else np.argsort(nearest)
        best: Floats = unit[order[:LOCAL_BEST]]
        return best


def propose_constrained(
    first: InstanceMeanGP, constraint: Constraint, pending: Sequence[Mapping[str, Any]], seed: int
) -> tuple[Values, float]:
    """Return the configuration with the largest noisy expected improvement within the limit, and that improvement.

    The improvement counts by the probability of meeting the constraint (Gardner et al., ICML 2014, in BoTorch's logarithmic
    form); before anything meets it, the search is for what does, and where nothing comes near, for the least violation.
    """
    model = first
    running = model.inputs_at(pending) if pending else None
    with numerics():
        near = constraint.promising(first)
        if constraint.is_hopeless():
            model = constraint.model
            acquisition: AcquisitionFunction = noisy_improvement(model, near, running, seed)
        else:
            acquisition = _with_probability(first, constraint, running, seed)
        position, score = maximise(model, acquisition, seed, near=near)
    return first.space.from_unit(position), math.exp(score) * first.mean_scale


def _with_probability(
    first: InstanceMeanGP, constraint: Constraint, running: torch.Tensor | None, seed: int
) -> AcquisitionFunction:
    second, floor = constraint.model, constraint.floor()
    model = ModelListGP(first.model, second.model)
    objective = GenericMCObjective(lambda samples, X=None: samples[..., 0])
    constraints = [lambda samples: floor - samples[..., 1]]
    evaluated = first.inputs(first.evaluated[0])
    return qLogNoisyExpectedImprovement(
        model,
        X_baseline=pruned(model, evaluated, seed, objective=objective, constraints=constraints),
        sampler=SobolQMCNormalSampler(torch.Size([MONTE_CARLO_SAMPLES]), seed=seed),
        objective=objective,
        constraints=constraints,
        X_pending=running,
        prune_baseline=False,
        cache_root=False,
    )
