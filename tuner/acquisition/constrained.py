"""Optimisation under an outcome constraint on a second objective: what to run next, and which configurations meet it."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from botorch.acquisition import AcquisitionFunction
from botorch.acquisition.logei import qLogNoisyExpectedImprovement
from botorch.acquisition.objective import GenericMCObjective
from botorch.models import ModelListGP
from botorch.sampling import SobolQMCNormalSampler
from scipy import special

from nbv.types import Bools, Floats
from tuner.acquisition.expected_saving import LogExpectedSaving
from tuner.acquisition.propose import LOCAL_BEST, MONTE_CARLO_SAMPLES, maximise, noisy_improvement
from tuner.problem.deterministic_metrics import with_second_first
from tuner.problem.goal import Goal
from tuner.problem.observations import Observation
from tuner.problem.problem import Problem
from tuner.problem.search_space import Values
from tuner.surrogate.model import InstanceMeanGP, moments
from tuner.surrogate.numerics import numerics, pruned
from tuner.surrogate.posterior import FREEDOM, DeterministicOutcome, probability_positive

_CHUNK = 64
SURE = 0.8  # probability from which on a configuration is taken to meet a constraint
HOPELESS = 0.05  # probability of meeting the constraint
Allowed = Callable[[Floats], Bools]
ObjectiveModel = InstanceMeanGP | DeterministicOutcome


def two_models(
    problem: Problem,
    goal: Goal,
    observations: Sequence[Observation],
    sparse: bool | None = None,
) -> tuple[ObjectiveModel, ObjectiveModel]:
    """Return a model of each objective, on the missions that have both outcomes or failed.

    An objective that the configuration decides is computed, but one of the two is always a surrogate: where both are decided,
    the second one. ``ValueError`` means that there are no such missions.
    """
    second = second_model(problem, goal, observations, sparse)
    if goal.exact.first is not None:
        return DeterministicOutcome(problem.space, goal.exact.first), second
    both = [o for o in observations if o.outcome is None or o.second is not None]
    return InstanceMeanGP(problem.space, both, problem.instances, sparse=sparse), second


def second_model(
    problem: Problem,
    goal: Goal,
    observations: Sequence[Observation],
    sparse: bool | None = None,
) -> ObjectiveModel:
    """Return the model of the second objective, as `two_models`."""
    if goal.exact.first is None and goal.exact.second is not None:
        return DeterministicOutcome(problem.space, goal.exact.second)
    return InstanceMeanGP(problem.space, with_second_first(observations), problem.instances, sparse=sparse)


@dataclass(frozen=True)
class Constraint:
    """A lower limit on the second objective's mean over the training instances."""

    model: ObjectiveModel  # of the second objective
    at_least: float  # oriented so that larger is better

    def within_reach(self) -> Constraint:
        """Return this constraint, or where a deterministic metric cannot meet it anywhere, the least violation that there is."""
        if not isinstance(self.model, DeterministicOutcome):
            return self
        return dataclasses.replace(self, at_least=min(self.at_least, self.model.best()))

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
        if isinstance(self.model, DeterministicOutcome):
            return self.model.keeps(mean, self.at_least).astype(float)
        sd = np.maximum(sd, 1e-9 * self.model.mean_scale)
        return np.array([probability_positive(m - self.at_least, s) for m, s in zip(mean, sd)])

    def keeps(self, configurations: Sequence[Mapping[str, Any]]) -> list[bool]:
        """Return whether each can be taken to meet the constraint."""
        return [bool(p >= SURE) for p in self.probability(configurations)] if configurations else []

    @property
    def quantile(self) -> float:
        """Standard deviations above the limit at which it counts as kept."""
        return float(special.stdtrit(FREEDOM, SURE))

    def floor(self) -> float:
        """Return the limit on the model's common landscape, whose offsets belong to the limit."""
        model = self.model
        assert isinstance(model, InstanceMeanGP)
        unit, configurations = model.evaluated
        mean, _ = self.means_and_sds(configurations)
        with torch.no_grad():
            level, _ = moments(model.model.posterior(model.inputs(unit)))
        return (self.at_least - float(np.mean(mean - model.mean_scale * level))) / model.mean_scale

    def is_hopeless(self) -> bool:
        """Whether nothing that was run has a chance to meet the constraint, which only missions show."""
        if isinstance(self.model, DeterministicOutcome):
            return False
        return bool((self.probability(self.model.evaluated[1]) < HOPELESS).all())

    def promising(self, first: ObjectiveModel) -> Floats:
        """Return (few, d) unit positions run: the best that may meet the constraint, else those nearest to it."""
        unit, configurations = surrogate_of((first, self.model)).evaluated
        chance = self.probability(configurations)
        if isinstance(first, DeterministicOutcome):
            means = first.posterior(configurations).mean
        else:
            with torch.no_grad():
                means, _ = moments(first.model.posterior(first.inputs(unit)))
        nearest = -self.means_and_sds(configurations)[0]
        order = np.lexsort((-means, chance < 0.5)) if (chance >= 0.5).any() else np.argsort(nearest)
        best: Floats = unit[order[:LOCAL_BEST]]
        return best

    def allowed(self) -> Allowed | None:
        """Return a function that tells which (n, d) unit positions meet the constraint; None where that is uncertain."""
        model = self.model
        if not isinstance(model, DeterministicOutcome):
            return None
        return lambda unit: model.keeps(model.at(torch.from_numpy(unit)).numpy(), self.at_least)


def surrogate_of(models: Sequence[ObjectiveModel]) -> InstanceMeanGP:
    """Return the first of ``models`` that is a surrogate."""
    return next(model for model in models if isinstance(model, InstanceMeanGP))


def propose_constrained(
    first: ObjectiveModel, constraint: Constraint, pending: Sequence[Mapping[str, Any]], seed: int
) -> tuple[Values, float]:
    """Return the configuration with the largest noisy expected improvement within the limit, and that improvement.

    The improvement counts by the probability of meeting the constraint (Gardner et al., ICML 2014, in BoTorch's logarithmic
    form); before anything meets it, the search is for what does, and where nothing comes near, for the least violation. Deterministic metrics are computed: as the objective at
    every point, as the constraint so that nothing that violates it is proposed.
    """
    model, known = surrogate_of((first, constraint.model)), constraint.allowed()
    running = model.inputs_at(pending) if pending else None
    with numerics():
        near = constraint.promising(first)
        if constraint.is_hopeless():
            model = surrogate_of((constraint.model,))
            acquisition: AcquisitionFunction = noisy_improvement(model, near, running, seed)
        elif known is not None:
            unit, _ = model.evaluated
            baseline = unit[known(unit)]
            running = None if running is None else running[known(running[:, : model.space.dimension].numpy())]
            acquisition = noisy_improvement(model, baseline if len(baseline) else near[:1], running, seed)
        elif isinstance(first, DeterministicOutcome):
            _, evaluated = model.evaluated
            keeping = [v for v, keeps in zip(evaluated, constraint.keeps(evaluated)) if keeps]
            # Before anything counts as meeting the constraint, all that may keep it saves against the most expensive there is.
            best = float(max(first.posterior(keeping).mean) if keeping else first.worst() - 1.0)
            at_least, quantile = constraint.at_least, constraint.quantile
            acquisition = LogExpectedSaving(model, first, at_least, quantile, best, running)
        else:
            acquisition = _with_probability(first, constraint, running, seed)
        position, score = maximise(model, acquisition, seed, near=near, allowed=known)
    unit_gain = 1.0 if isinstance(first, DeterministicOutcome) else first.mean_scale
    return model.space.from_unit(position), math.exp(score) * unit_gain


def _with_probability(
    first: InstanceMeanGP, constraint: Constraint, running: torch.Tensor | None, seed: int
) -> AcquisitionFunction:
    second, floor = constraint.model, constraint.floor()
    assert isinstance(second, InstanceMeanGP)
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
