"""Optimisation under an outcome constraint on a second objective: what to run next, and which configurations meet it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from botorch.acquisition import AcquisitionFunction
from botorch.acquisition.logei import qLogExpectedImprovement
from botorch.acquisition.objective import GenericMCObjective
from botorch.models import ModelListGP
from botorch.sampling import SobolQMCNormalSampler

from nbv.types import Floats
from tuner.acquisition.propose import (
    LOCAL_BEST,
    MONTE_CARLO_SAMPLES,
    maximise,
    noisy_improvement,
    starting_points,
)
from tuner.problem.goal import with_second_first
from tuner.problem.observations import Observation
from tuner.problem.search_space import Problem, Values
from tuner.surrogate.fit import numerics, probability_positive, tensor
from tuner.surrogate.model import InstanceMeanGP

_CHUNK = 64
SURE = 0.8  # probability from which on a configuration is taken to meet a constraint
HOPELESS = 0.05  # probability of meeting the constraint


def two_models(
    problem: Problem, observations: Sequence[Observation]
) -> tuple[InstanceMeanGP, InstanceMeanGP]:
    """Return a model of each objective, on the missions that have both outcomes or failed.

    ``ValueError`` means that there are no such missions.
    """
    both = [o for o in observations if o.outcome is None or o.second is not None]
    return (
        InstanceMeanGP(problem.space, both, problem.instances),
        second_model(problem, observations),
    )


def second_model(problem: Problem, observations: Sequence[Observation]) -> InstanceMeanGP:
    """Return the model of the second objective, as `two_models`."""
    return InstanceMeanGP(problem.space, with_second_first(observations), problem.instances)


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

    def satisfied(self, configurations: Sequence[Mapping[str, Any]]) -> list[bool]:
        """Return whether each can be taken to meet the constraint."""
        return [bool(p >= SURE) for p in self.probability(configurations)] if configurations else []

    def floor(self) -> float:
        """Return the limit on the model's common landscape, whose offsets belong to the limit."""
        model = self.model
        unit, configurations = model.evaluated
        mean, _ = self.means_and_sds(configurations)
        level = model.mean_scale * model.means(unit)
        return (self.at_least - float(np.mean(mean - level))) / model.mean_scale

    def incumbent(self, first: InstanceMeanGP) -> float:
        """Return the best posterior mean, on the common landscape, of what is taken to meet the constraint, else the worst of all."""
        means, satisfied = first.means(self.model.evaluated[0]), self.satisfied(self.model.evaluated[1])
        return float(means[satisfied].max() if any(satisfied) else means.min())

    def is_hopeless(self) -> bool:
        """Whether nothing that was run has a chance to meet the constraint, which only missions show."""
        return bool((self.probability(self.model.evaluated[1]) < HOPELESS).all())

    def promising(self, first: InstanceMeanGP) -> Floats:
        """Return (few, d) unit positions run: the best that may meet the constraint, else those nearest to it."""
        unit, configurations = self.model.evaluated
        chance = self.probability(configurations)
        nearest = -self.means_and_sds(configurations)[0]
        order = np.argsort(nearest)
        if (chance >= 0.5).any():
            order = np.lexsort((-first.means(unit), chance < 0.5))
        best: Floats = unit[order[:LOCAL_BEST]]
        return best


def propose_constrained(
    first: InstanceMeanGP, constraint: Constraint, pending: Sequence[Mapping[str, Any]], seed: int
) -> tuple[Values, float]:
    """Return the configuration with the largest expected improvement within the limit, and that improvement.

    It is over the best that is taken to meet the constraint: over the best of each draw, a search for the fewest photographs goes on
    below the limit. It counts by the probability of meeting the constraint (Gardner et al., ICML 2014, in BoTorch's logarithmic form)
    with a mission's noise to spare, so that few missions can show it. Where nothing comes near, the least violation is sought.
    """
    model = first
    running = model.inputs_at(pending) if pending else None
    with numerics():
        near = constraint.promising(first)
        if constraint.is_hopeless():
            model = constraint.model
            acquisition: AcquisitionFunction = noisy_improvement(model, near, running, seed)
        else:
            floor = constraint.floor() + math.sqrt(constraint.model.model.likelihood.noise.item())
            objective = GenericMCObjective(lambda samples, X=None: samples[..., 0])
            constraints = [lambda samples: floor - samples[..., 1]]
            models = ModelListGP(first.model, constraint.model.model)
            acquisition = qLogExpectedImprovement(
                models,
                best_f=constraint.incumbent(first),
                sampler=SobolQMCNormalSampler(torch.Size([MONTE_CARLO_SAMPLES]), seed=seed),
                objective=objective,
                constraints=constraints,
                X_pending=running,
            )
        position, score = maximise(model, acquisition, seed, near=near)
    return first.space.from_unit(position), math.exp(score) * first.mean_scale


# Many proposals at once by Thompson sampling (Thompson, Biometrika 1933; Kandasamy et al., AISTATS 2018).


GLOBAL_POINTS, LOCAL_POINTS = 256, 1024
_INFEASIBLE_PENALTY = 1e6  # standard deviations: puts what would fail below all that works
_TIE_BREAK = 1e-6  # standard deviations
_VIOLATION_PENALTY = 1e3  # likewise: puts what violates the constraint below all that meets it


def thompson_configurations(
    models: Sequence[InstanceMeanGP],
    constraint: Constraint | None,
    count: int,
    seed: int,
) -> list[Values]:
    """Return ``count`` configurations, each the best of one posterior draw that may work; no two are alike.

    Draws are over candidate configurations from the whole space and near the best that was run. With an outcome constraint a
    draw's best has the best objective among those that meet it in this draw, or else the least violation.
    """
    model = models[0]
    with numerics(), torch.no_grad():
        near = None if constraint is None else constraint.promising(model)
        points = starting_points(model, seed, GLOBAL_POINTS, LOCAL_POINTS, near)
        points = np.unique([model.space.snap(x) for x in points], axis=0)
        inputs = model.inputs(points)
        generator = torch.Generator().manual_seed(seed)

        def drawn(model: InstanceMeanGP) -> torch.Tensor:  # (count, points) on the model's own scale
            normal = torch.randn(count, len(inputs), generator=generator, dtype=inputs.dtype)
            return model.model.posterior(inputs).rsample_from_base_samples(torch.Size([count]), normal)[
                ..., 0
            ]

        draws, *others = map(drawn, models)
        if constraint is not None:  # of what costs the same the better one
            (second,) = others
            draws = torch.where(
                second >= constraint.floor(), draws + _TIE_BREAK * second, second - _VIOLATION_PENALTY
            )
        if model.feasibility is not None:
            # One random number per draw decides what fails in it: with one per point, some of many points would pass.
            chance = model.feasibility.log_chance(tensor(points)).exp()
            refused = torch.rand(count, 1, dtype=chance.dtype, generator=generator) > chance
            draws[refused] -= _INFEASIBLE_PENALTY
    chosen: list[int] = []
    for one in draws:
        if len(chosen) < len(points):
            one[chosen] = -torch.inf
        chosen.append(int(one.argmax()))
    return [model.space.from_unit(points[i]) for i in chosen]
