"""Gaussian process over configurations: what the missions so far say about every configuration.

Outcomes are standardised per rock (``tuner.problem.standardise.RockStandardiser``). The model is then

    z(x, instance, replicate) = f(x) + b(instance) + c(instance, replicate) + noise

with an independent offset b per instance, that is, per rock under a condition: with a handful of missions on each rock the
standardisation cannot know whether a rock is hard or was run with poor configurations; the offsets, inferred together with f, can.
Missions on one (instance, replicate) block also share the arrival errors of the seed orbit, which can move all of them by more
than configurations differ: with c configurations are compared within blocks, and it cancels. The mean over instances has c = 0:
it is over replicates that were not run. What instances do not share beyond offsets and a scale ends up in the noise, which is
right for a mean over them.

The length-scale prior grows with the square root of the dimension (Hvarfner et al., ICML 2024), but is narrower than theirs, there
is an output scale, and the noise prior expects noise: on synthetic data as noisy as the signal these were the better calibrated.
"""

from __future__ import annotations

import collections
import functools
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import gpytorch
import numpy as np
import torch
from botorch.cross_validation import efficient_loo_cv

from nbv.types import Floats
from tuner.problem.instances import Instance
from tuner.problem.observations import Observation, distinct_configurations
from tuner.problem.search_space import MANY_PARAMETERS, SearchSpace, Values
from tuner.problem.standardise import RockStandardiser, winsorised
from tuner.surrogate.fit import (
    NO_OFFSET,
    NORMAL_95,
    Feasibility,
    Posterior,
    fitted,
    fitted_subset,
    mission_kernel,
    numerics,
    posterior_means,
    tensor,
    with_promising,
)


def moments(posterior: Any) -> tuple[Floats, Floats]:
    """Return ``(mean, covariance)`` of a joint posterior, (m,) and (m, m)."""
    return posterior.distribution.mean.numpy(), posterior.distribution.covariance_matrix.numpy()


class InstanceMeanGP:
    """The Gaussian process described above; predicts the mean over the training instances.

    ``observations``: finished missions; failed ones tell the search alone, by `feasibility`. At least one must be
    feasible. ``instances``: the training instances over which the mean is taken. ``sparse``: whether length scales have a SAAS
    prior and there are linear trends, which find the best gate more often (docs/results/index.md); None: from
    `MANY_PARAMETERS` on.
    """

    def __init__(
        self,
        space: SearchSpace,
        observations: Sequence[Observation],
        instances: Sequence[Instance],
        *,
        sparse: bool | None = None,
    ) -> None:
        feasible = [o for o in observations if o.outcome is not None]
        if not feasible:
            raise ValueError("no feasible observation to learn from")
        self.space = space
        self.instances = tuple(instances)
        self.observations = tuple(feasible)
        self.winsorised = outcomes = winsorised(
            [o.instance for o in feasible], [o.outcome or 0.0 for o in feasible]
        )
        rocks = [o.rock for o in feasible]
        evaluated = [(o.instance, o.replicate) for o in feasible]
        blocks = blocks_identifiable(evaluated)
        self.standardiser = RockStandardiser.fit(
            rocks, outcomes, shrink_centres=False, blocks=evaluated if blocks else None
        )
        self.unit = np.array([space.to_unit(o.values) for o in feasible])  # (n, d)
        self._failed = [space.to_unit(o.values) for o in observations if o.outcome is None]
        # (n,), to a hundredth of the least noise: what a number's last digits round to proposes nothing
        self.targets = np.round(self.standardiser.standardise(rocks, outcomes), 4)
        known = _levels([*self.instances, *(o.instance for o in feasible)])
        self._instance_index: dict[Instance | None, float] = {None: NO_OFFSET, **known}
        self._block_index = _levels(evaluated)
        columns = np.array(
            [self.levels(instance, self._block_index[instance, k]) for instance, k in evaluated]
        )
        x, y = tensor(np.column_stack([self.unit, columns])), tensor(self.targets[:, None])
        # Indices of the missions that hyperparameters are fitted to.
        self.fitted_to = fitted_subset(len(feasible))
        ordered = [i for i in range(space.dimension) if i not in space.categorical_dimensions]
        if sparse is None:
            sparse = space.dimension >= MANY_PARAMETERS
        with numerics():
            shares, choices = weights_beside_main(space), space.categorical_dimensions
            kernel = mission_kernel(ordered, choices, blocks=blocks, sparse=sparse, beside_main=shares)
            self._fitted = fitted(kernel, x[self.fitted_to], y[self.fitted_to])
            self.model = self._fitted if len(self.fitted_to) == len(x) else with_promising(self._fitted, x, y)

    @functools.cached_property
    def configurations(self) -> list[Values]:
        """Each configuration that has run, once."""
        return distinct_configurations(self.space, self.observations)

    @functools.cached_property
    def feasibility(self) -> Feasibility | None:
        """The model of where missions end well; None where none has failed."""
        if not self._failed:
            return None
        return Feasibility(self.space, self.unit, np.array(self._failed))

    def levels(self, instance: Instance | None, block: float = NO_OFFSET) -> list[float]:
        """Return the input columns behind the unit cube's: instance and block; for none configurations are compared without offsets."""
        return [self._instance_index[instance], block]

    def inputs(
        self, unit: Floats, instance: Instance | None = None, block: float = NO_OFFSET
    ) -> torch.Tensor:
        """Return (m, d + 2) model inputs for (m, d) unit positions, by default without offsets of rock and block."""
        return tensor(np.column_stack([unit, np.tile(self.levels(instance, block), (len(unit), 1))]))

    def inputs_at(self, values: Sequence[Mapping[str, Any]]) -> torch.Tensor:
        """Return (m, d + 2) model inputs of configurations, without offsets."""
        return self.inputs(np.array([self.space.to_unit(v) for v in values]))

    def posterior(self, values: Sequence[Mapping[str, Any]]) -> Posterior:
        """Return the joint posterior of the mean over the training instances at the configurations."""
        x = self.inputs_at(values)
        with torch.no_grad(), gpytorch.settings.fast_pred_var(False):
            mean, covariance = self.mean_over_instances(x)
        return Posterior(mean.numpy(), covariance.numpy())

    def mean_over_instances(self, x: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return (..., q) means and (..., q, q) covariance of the mean over the training instances; differentiable.

        ``x``: (..., q, d + 2) inputs, whose instance and block are replaced.
        """
        q, count, d = x.shape[-2], len(self.instances), self.space.dimension
        levels = [
            x.new_tensor(level).expand(*x.shape[:-1], len(level))
            for level in map(self.levels, self.instances)
        ]
        everywhere = torch.cat([torch.cat([x[..., :d], level], dim=-1) for level in levels], dim=-2)
        joint_posterior = self.model.posterior(everywhere).distribution
        scales = x.new_tensor([self.standardiser.scale(instance.rock) for instance in self.instances]) / count
        centre = sum(self.standardiser.centre(instance.rock) for instance in self.instances) / count
        joint = joint_posterior.covariance_matrix.unflatten(-1, (count, q)).unflatten(-3, (count, q))
        return (
            centre + torch.einsum("r,...rq->...q", scales, joint_posterior.mean.unflatten(-1, (count, q))),
            torch.einsum("r,s,...rmsn->...mn", scales, scales, joint),
        )

    def best_first(self, values: Sequence[Mapping[str, Any]]) -> list[int]:
        """Return the indices of the configurations, the best posterior mean first, in time linear in their number."""
        means = posterior_means(self.model, self.inputs_at(values))
        order: list[int] = means.argsort(descending=True, stable=True).tolist()
        return order

    def means(self, unit: Floats) -> Floats:
        """Return (m,) posterior means at (m, d) unit positions, on the common landscape of all instances."""
        with torch.no_grad():
            return moments(self.model.posterior(self.inputs(unit)))[0]

    @functools.cached_property
    def evaluated(self) -> tuple[Floats, list[Values]]:
        """(m, d) unit positions run, each once, and their configurations."""
        unit = np.unique(self.unit, axis=0)
        return unit, [self.space.from_unit(u) for u in unit]

    def promising(self, count: int) -> Floats:
        """Return (m, d) unit positions run, each once: all, or the ``count`` with the best posterior means."""
        seen, _ = self.evaluated
        if len(seen) <= count:
            return seen
        means = posterior_means(self.model, self.inputs(seen)).numpy()
        chosen: Floats = seen[np.sort(np.argsort(-means)[:count])]
        return chosen

    def predict_mission(self, values: Mapping[str, Any], instance: Instance) -> tuple[float, float]:
        """Return ``(mean, sd)`` of the outcome of one new mission in a known instance, on a new block, its noise included."""
        x = self.inputs(self.space.to_unit(values)[None], instance, float(len(self._block_index)))
        with torch.no_grad():
            mean, covariance = moments(self.model.posterior(x, observation_noise=True))
        scale = self.standardiser.scale(instance.rock)
        return self.standardiser.centre(instance.rock) + scale * float(mean[0]), scale * math.sqrt(
            covariance[0, 0]
        )

    @property
    def noise_sd(self) -> float:
        """Standard deviation of one mission's outcome beside its block's offset, objective's unit."""
        return math.sqrt(self.model.likelihood.noise.item()) * self.mean_scale

    @property
    def mean_scale(self) -> float:
        """Objective's unit per unit of the common landscape, mean over the training instances."""
        return float(np.mean([self.standardiser.scale(instance.rock) for instance in self.instances]))

    def leave_one_out(self) -> dict[str, float]:
        """Return the share of the missions of ``fitted_to`` inside the 95 % intervals predicted from all others there."""
        return {"coverage_95": float(np.mean(np.abs(self.leave_one_out_z()) <= NORMAL_95))}

    def leave_one_out_z(self) -> Floats:
        """Return (m,) errors of those predictions, in standard deviations of each; hyperparameters are kept."""
        cv = efficient_loo_cv(self._fitted)
        errors = (cv.observed_Y - cv.posterior.mean) / cv.posterior.variance.sqrt()
        return errors.flatten().numpy()


def weights_beside_main(space: SearchSpace) -> list[tuple[list[int], Floats, float]]:
    """Return columns and (p, 2) ranges of each scorer's weights on a logarithmic scale, and its main weight, which is the base's."""
    found = []
    for main in (path for path in space.base if path.endswith(".weights.main")):
        beside = [(i, p) for i, p in enumerate(space.parameters) if p.path.startswith(main[: -len("main")])]
        if beside and all(p.scale == "log" for _, p in beside):
            ranges = np.array([(p.low, p.high) for _, p in beside])
            found.append(([i for i, _ in beside], ranges, float(space.base[main])))
    return found


def _levels(names: Iterable[Any]) -> dict[Any, float]:
    """Return each name's level, numbered in order."""
    return {name: float(i) for i, name in enumerate(dict.fromkeys(names))}


def blocks_identifiable(blocks: Sequence[tuple[Instance, int]]) -> bool:
    """Return whether missions on these (instance, replicate) blocks can tell block offsets from the instance's offset and noise.

    Some instance must have been run with two replicates, and some block twice in an instance that has another one.
    """
    missions = collections.Counter(blocks)
    replicates_of = collections.Counter(instance for instance, _ in missions)
    return any(count > 1 and replicates_of[instance] > 1 for (instance, _), count in missions.items())
