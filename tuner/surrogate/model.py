"""Gaussian process over configurations: what the missions so far say about every configuration.

Outcomes are standardised per rock, with several conditions by rock and condition
(``tuner.problem.standardise.RockStandardiser``). The model is then

    z(x, rock, replicate) = f(x) + b(rock) + c(rock, replicate) + noise

with a Matern-5/2 ARD kernel for f on the unit cube and an independent offset b per rock: with a handful of
missions on each rock the standardisation cannot know whether a rock is hard or was flown with poor
configurations; the offsets, inferred together with f, can. Missions on one (rock, replicate) block also share
the arrival errors of the seed orbit, which can move all of them together by more than configurations differ:
the offset c, nested in the rock's, makes them blocks of an experiment, so that configurations are compared within
them and the offset cancels. The mean over rocks has c = 0: it is the mean over replicates nobody has flown. What
rocks do not share beyond offsets and a scale ends up in the noise, which is right for a mean over rocks.

Where missions fly under several conditions, each condition has an offset and a departure of its own from f, and each
world (a rock under a condition) an offset; blocks are then nested in worlds. With one condition the model is the one above.

The length-scale prior grows with the square root of the dimension (Hvarfner et al., ICML 2024), but is
narrower than theirs, there is an output scale, and the noise prior expects noise: missions are noisy, and on
synthetic data as noisy as the signal these choices were the better calibrated ones. It is a BoTorch
``SingleTaskGP``: ``kernel.py`` has its covariance and priors, ``fit.py`` how they are fitted, ``condensed.py`` what keeps it small
beyond some hundred missions.
"""

from __future__ import annotations

import collections
import dataclasses
import functools
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import gpytorch
import numpy as np
import torch
from botorch.cross_validation import efficient_loo_cv
from botorch.models import SingleTaskGP

from nbv.types import Floats
from tuner.problem.observations import Observation
from tuner.problem.search_space import SearchSpace
from tuner.problem.standardise import RockStandardiser
from tuner.problem.worlds import Place, World, conditions_of, rocks_of, worlds_of
from tuner.surrogate.condensed import condensed, fitted_subset, posterior_means
from tuner.surrogate.feasibility import Feasibility
from tuner.surrogate.fit import fitted
from tuner.surrogate.kernel import (
    MEAN_LEVEL,
    NO_OFFSET,
    lengthscales,
    mission_kernel,
    shared_variance,
)
from tuner.surrogate.numerics import NORMAL_95, numerics, tensor
from tuner.surrogate.posterior import Posterior
from tuner.surrogate.settings import SurrogateSettings, surrogate_settings

SPARSE_TAUS = (1e-3, 1e-2, 1e-1, 1.0)


def moments(posterior: Any) -> tuple[Floats, Floats]:
    """Return ``(mean, covariance)`` of a joint posterior, (m,) and (m, m)."""
    return posterior.distribution.mean.numpy(), posterior.distribution.covariance_matrix.numpy()


class RockMeanGP:
    """The Gaussian process described above; predicts the mean over the training worlds.

    Parameters
    ----------
    space
        The search space.
    observations
        Finished missions; failed ones tell the search alone, by `feasibility`. At least one must be feasible.
    places
        The training worlds over which the mean is taken; a rock alone is that rock under ``ideal``.
    seed
        Seed of the fit.
    settings
        What the model is made of; None: by the number of parameters.
    """

    def __init__(
        self,
        space: SearchSpace,
        observations: Sequence[Observation],
        places: Sequence[Place],
        seed: int = 0,
        settings: SurrogateSettings | None = None,
    ) -> None:
        self.settings = settings or surrogate_settings(space)
        feasible = [o for o in observations if o.outcome is not None]
        if not feasible:
            raise ValueError("no feasible observation to learn from")
        self.space = space
        self.worlds = worlds_of(places)
        self.observations = tuple(feasible)
        outcomes = np.array([o.outcome for o in feasible], dtype=float)
        observed = [o.world for o in feasible]
        flown = [(o.world, o.replicate) for o in feasible]
        self._models_blocks = self.settings.blocks and blocks_identifiable(flown)
        known = [*self.worlds, *observed]
        self._several = len(conditions_of(known)) > 1
        if self._several:
            self.standardiser = RockStandardiser.over_conditions(observed, outcomes, self.worlds)
        else:
            self.standardiser = RockStandardiser.fit(
                observed, outcomes, shrink_centres=False, blocks=flown if self._models_blocks else None
            )
        self.unit = np.array([space.to_unit(o.values) for o in feasible])  # (n, d)
        self._failed = [space.to_unit(o.values) for o in observations if o.outcome is None]
        self._seed = seed
        self.targets = self.standardiser.standardise(observed, outcomes)  # (n,)
        self._rock_index = _levels(rocks_of(known))
        self._condition_index = _levels(conditions_of(known))
        self._world_index = _levels(known)
        self._block_index = _levels(flown)
        self._ordered = [i for i in range(space.dimension) if i not in space.categorical_dimensions]
        columns = np.array([self.levels(world, self._block_index[world, k]) for world, k in flown])
        x, y = tensor(np.column_stack([self.unit, columns])), tensor(self.targets[:, None])
        self.fitted_to = fitted_subset(
            len(feasible)
        )  # indices of the missions that hyperparameters are fitted to
        with numerics(seed):
            self._fitted = self._fit(x[self.fitted_to], y[self.fitted_to])
            self.model = self._fitted if len(self.fitted_to) == len(x) else condensed(self._fitted, x, y)

    @functools.cached_property
    def feasibility(self) -> Feasibility | None:
        """The model of where missions end well; None where none has failed."""
        if not self._failed:
            return None
        return Feasibility(self.space, self.unit, np.array(self._failed), self._seed)

    def _fit(self, x: torch.Tensor, y: torch.Tensor) -> SingleTaskGP:
        """Return the model fitted to (n, d + 2) inputs and (n, 1) outcomes."""
        settings = dataclasses.replace(self.settings, blocks=self._models_blocks)
        kernels = [
            mission_kernel(
                self._ordered,
                self.space.categorical_dimensions,
                self.space.dimension,
                settings,
                tau=tau,
                conditions=len(conditions_of(self.worlds)) if self._several else 0,
            )
            for tau in (SPARSE_TAUS if settings.sparse and self._ordered else (None,))
        ]
        return fitted(kernels, x, y)

    def levels(self, place: Place | None, block: float = NO_OFFSET) -> list[float]:
        """Return the input columns behind the unit cube's: rock and block and, over several conditions, condition and world.

        ``place`` is a known world, or None for the mean over the conditions at no rock: there the offsets are 0, so
        configurations are compared by their landscape alone.
        """
        if place is None:
            return [NO_OFFSET, block, MEAN_LEVEL, NO_OFFSET] if self._several else [NO_OFFSET, block]
        (world,) = worlds_of([place])
        own = [self._rock_index[world.rock], block]
        if self._several:
            unknown = float(len(self._world_index))
            own += [self._condition_index[world.condition], self._world_index.get(world, unknown)]
        return own

    def block_level(self, place: Place, replicate: int | None) -> float:
        """Return the block column of a (world, replicate); one that has not been flown has a level without data."""
        (world,) = worlds_of([place])
        unknown = float(len(self._block_index))
        return unknown if replicate is None else self._block_index.get((world, replicate), unknown)

    def inputs(self, unit: Floats, place: Place | None = None, block: float = NO_OFFSET) -> torch.Tensor:
        """Return (m, d + 2 or 4) model inputs for (m, d) unit positions, by default without offsets of rock and block."""
        return tensor(np.column_stack([unit, np.tile(self.levels(place, block), (len(unit), 1))]))

    def posterior(self, values: Sequence[Mapping[str, Any]]) -> Posterior:
        """Return the joint posterior of the mean over the training worlds at the configurations."""
        x = self.inputs(np.array([self.space.to_unit(v) for v in values]))
        with torch.no_grad(), gpytorch.settings.fast_pred_var(False):
            mean, covariance = self.mean_over_worlds(x)
        return Posterior(mean.numpy(), covariance.numpy())

    def mean_over_worlds(self, x: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return (..., q) means and (..., q, q) covariance of the mean over the training worlds; differentiable.

        ``x``: (..., q, d + 2) inputs, whose world and block are replaced.
        """
        q, count, d = x.shape[-2], len(self.worlds), self.space.dimension
        levels = [
            x.new_tensor(level).expand(*x.shape[:-1], len(level)) for level in map(self.levels, self.worlds)
        ]
        everywhere = torch.cat([torch.cat([x[..., :d], level], dim=-1) for level in levels], dim=-2)
        belief = self.model.posterior(everywhere).distribution
        scales = x.new_tensor([self.standardiser.scale(world) for world in self.worlds]) / count
        centre = sum(self.standardiser.centre(world) for world in self.worlds) / count
        joint = belief.covariance_matrix.unflatten(-1, (count, q)).unflatten(-3, (count, q))
        return (
            centre + torch.einsum("r,...rq->...q", scales, belief.mean.unflatten(-1, (count, q))),
            torch.einsum("r,s,...rmsn->...mn", scales, scales, joint),
        )

    def best_first(self, values: Sequence[Mapping[str, Any]]) -> list[int]:
        """Return the indices of the configurations, the best posterior mean first, in time linear in their number."""
        unit = np.array([self.space.to_unit(v) for v in values])
        means = posterior_means(self.model, self.inputs(unit))
        order: list[int] = means.argsort(descending=True, stable=True).tolist()
        return order

    def promising(self, count: int) -> Floats:
        """Return (m, d) unit positions flown, each once: all, or the ``count`` with the best posterior means."""
        seen = np.unique(self.unit, axis=0)
        if len(seen) <= count:
            return seen
        means = posterior_means(self.model, self.inputs(seen)).numpy()
        chosen: Floats = seen[np.sort(np.argsort(-means)[:count])]
        return chosen

    def predict_mission(
        self, values: Mapping[str, Any], place: Place, replicate: int | None = None
    ) -> tuple[float, float]:
        """Return ``(mean, sd)`` of the outcome of one new mission on a known rock under a known condition, its noise included.

        On the block of a ``replicate`` flown before, what that block taught is used; any other replicate, or
        None, is a block like the others whose offset is not known.
        """
        (world,) = worlds_of([place])
        return self.predict_missions([(values, world, replicate)])[0]

    def predict_missions(
        self, missions: Sequence[tuple[Mapping[str, Any], World, int | None]]
    ) -> list[tuple[float, float]]:
        """Return `predict_mission` of each of several."""
        with torch.no_grad():
            x = [
                self.inputs(self.space.to_unit(values)[None], world, self.block_level(world, replicate))
                for values, world, replicate in missions
            ]
            means, covariance = moments(self.model.posterior(torch.cat(x), observation_noise=True))
        found = []
        for (_, world, _), mean, variance in zip(missions, means, covariance.diagonal()):
            scale = self.standardiser.scale(world)
            found.append((self.standardiser.centre(world) + scale * float(mean), scale * math.sqrt(variance)))
        return found

    def predict_in_world(self, values: Mapping[str, Any], place: Place) -> float:
        """Return the posterior mean outcome of one configuration in one known world, in the objective's unit."""
        return self.predict_mission(values, place)[0]

    @property
    def noise_sd(self) -> float:
        """Standard deviation of one mission's outcome beside its block's offset, objective's unit."""
        return math.sqrt(self.model.likelihood.noise.item()) * self.mean_scale

    @property
    def block_sd(self) -> float | None:
        """Standard deviation of the (world, replicate) offsets, objective's unit; None where not modelled."""
        if not self._models_blocks:
            return None
        return math.sqrt(shared_variance(self.model.covar_module, self.space.dimension + 1)) * self.mean_scale

    @property
    def one_mission_sd(self) -> float:
        """Standard deviation of one mission on a block that nobody has flown, objective's unit."""
        return math.hypot(self.noise_sd, self.block_sd or 0.0)

    @property
    def mean_scale(self) -> float:
        """Objective's unit per unit of the common landscape, mean over the training worlds."""
        return float(np.mean([self.standardiser.scale(world) for world in self.worlds]))

    @property
    def lengthscales(self) -> dict[str, float]:
        """Length scale per ordered parameter, in unit-cube units; long means unimportant."""
        ordered = [p.path for p in self.space.parameters if p.kind != "categorical"]
        return dict(zip(ordered, lengthscales(self.model.covar_module)))

    def leave_one_out(self) -> dict[str, float]:
        """Return how well each mission of ``fitted_to`` is predicted from all others there, hyperparameters kept.

        Share in the 95 % intervals, standard deviation of the standardised residuals, and root mean square error of the
        standardised outcomes.
        """
        found = efficient_loo_cv(self._fitted)
        error = (found.observed_Y - found.posterior.mean).flatten().numpy()
        z = error / found.posterior.variance.sqrt().flatten().numpy()
        return {
            "coverage_95": float(np.mean(np.abs(z) <= NORMAL_95)),
            "z_sd": float(np.std(z)),
            "rmse": float(np.sqrt(np.mean(error**2))),
        }


def _levels(names: Iterable[Any]) -> dict[Any, float]:
    """Return each name's level, numbered in order."""
    return {name: float(i) for i, name in enumerate(dict.fromkeys(names))}


def blocks_identifiable(blocks: Sequence[tuple[World, int]]) -> bool:
    """Return whether missions on these (world, replicate) blocks can tell block offsets from the world's offset and noise.

    Some world must have been flown with two replicates, and some block twice in a world that has another one.
    """
    missions = collections.Counter(blocks)
    per_world = collections.Counter(world for world, _ in missions)
    return any(count > 1 and per_world[world] > 1 for (world, _), count in missions.items())
