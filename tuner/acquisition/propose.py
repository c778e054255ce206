"""What to run next: log noisy expected improvement of the mean over instances (Ament et al., NeurIPS 2023)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch
from botorch.acquisition import AcquisitionFunction
from botorch.acquisition.logei import TAU_RELU
from botorch.models import SingleTaskGP
from botorch.optim import optimize_acqf
from botorch.utils.safe_math import log_fatplus, logmeanexp
from botorch.utils.sampling import draw_sobol_normal_samples, draw_sobol_samples
from linear_operator.utils.cholesky import psd_safe_cholesky

from nbv.types import Floats
from tuner.problem.search_space import Region, Values
from tuner.surrogate.fit import EXACT_MISSIONS, numerics, pruned
from tuner.surrogate.model import InstanceMeanGP

POINTS_AT_ONCE = 128
LOCAL_BEST = 4
LOCAL_SD = (0.01, 0.25)  # of the unit cube: smallest and largest, evenly spread logarithms
MONTE_CARLO_SAMPLES = 64
MAX_ITERATIONS = 50
BASELINE = EXACT_MISSIONS  # run configurations that an improvement is over; of more, the best
# Mixed spaces: the continuous part is optimised under this many of the best discrete combinations.
DISCRETE_COMBINATIONS = 4
RESTARTS = 4  # gradient searches
GLOBAL_POINTS = 512  # of a Sobol sequence over the whole space
LOCAL_POINTS = 256  # near the best configurations so far, where improvement is likeliest
_JITTER = 1e-6  # of the variance: configurations in flight may be nearly alike
_SMALLEST_VARIANCE = 1e-8


def propose(
    model: InstanceMeanGP, pending: Sequence[Mapping[str, Any]], seed: int, region: Region | None = None
) -> tuple[Values, float]:
    """Return the configuration with the largest acquisition value, and its expected improvement, objective's unit.

    Missions in flight count as points whose outcome is not known yet, so that simultaneous proposals differ. ``region``: the part
    of the space that is searched, over whose best configuration the improvement is; None: all of it.
    """
    with numerics():
        seen = model.promising(BASELINE)
        if region is not None and region.inside(seen).any():
            seen = seen[region.inside(seen)]
            pending = [values for values in pending if region.contains(values)]
        running = model.inputs_at(pending) if pending else None
        acquisition = noisy_improvement(model, seen, running, seed)
        position, score = maximise(model, acquisition, seed, seen if region else None, region=region)
    return model.space.from_unit(position), math.exp(score) * model.mean_scale


def noisy_improvement(
    model: InstanceMeanGP, unit: Floats, running: torch.Tensor | None, seed: int
) -> LogNoisyImprovement:
    """Return the expected improvement over the best of (n, d) positions that have run and of (m, inputs) in flight."""
    baseline = pruned(model.model, model.inputs(unit), seed)
    if running is not None:
        baseline = torch.unique(torch.cat([baseline, running]), dim=0)
    return LogNoisyImprovement(model.model, baseline, MONTE_CARLO_SAMPLES, seed)


def maximise(
    model: InstanceMeanGP,
    acquisition: AcquisitionFunction,
    seed: int,
    near: Floats | None = None,
    region: Region | None = None,
) -> tuple[Floats, float]:
    """Return the best (d,) unit position, exactly a configuration, and its acquisition value.

    Starts are the best of many global points and of local ones, tried without gradients.

    ``near``: (n, d) positions around which to start, too; None: those run with the best posterior means. ``region``: which part of
    the space is searched; None: all of it.
    """
    d = model.space.dimension
    acquisition = _WhereFeasible(acquisition, model)
    discrete = model.space.discrete_dimensions
    points = starting_points(model, seed, near_to=None if near is None else best_of(model, near))
    if region is not None:
        points = region.project(points)
    if discrete:
        points = np.array([model.space.snap(x) for x in points])
    starts = model.inputs(points).unsqueeze(1)
    with torch.no_grad():
        scores = torch.cat([acquisition(some) for some in starts.split(POINTS_AT_ONCE)])
    order = scores.argsort(descending=True)
    best, best_score = points[int(order[0])], float(scores[order[0]])
    if len(discrete) == d:
        return best, best_score
    # The last columns are instance and block: everything is compared without their offsets.
    nowhere = dict(enumerate(starts[0, 0, d:].tolist(), start=d))
    bounds = torch.zeros(2, starts.shape[-1], dtype=torch.float64)
    bounds[1, :d] = 1.0
    bounds[:, d:] = starts[0, 0, d:]
    held = dict[int, float]()
    if region is not None:
        ends = region.project(np.array([[0.0] * d, [1.0] * d]))
        held = {i: float(low) for i, (low, high) in enumerate(ends.T) if low == high}
        bounds[1, :d] = torch.from_numpy(np.where(ends[0] == ends[1], 1.0, ends[1]))
    for fixed, chosen in _gradient_starts(points, order.tolist(), discrete):
        position, score = optimize_acqf(
            acquisition,
            bounds,
            1,
            len(chosen),
            batch_initial_conditions=starts[chosen],
            options={"maxiter": MAX_ITERATIONS},
            fixed_features={**held, **fixed, **nowhere},
        )
        if float(score) > best_score:
            best, best_score = position[0, :d].numpy(), float(score)
    return best, best_score


class _WhereFeasible(AcquisitionFunction):
    """The logarithm of an acquisition value times the probability that the mission ends well."""

    def __init__(self, acquisition: AcquisitionFunction, model: InstanceMeanGP) -> None:
        super().__init__(acquisition.model)
        self._acquisition = acquisition
        self._feasibility, self._dimension = model.feasibility, model.space.dimension

    def forward(self, X: torch.Tensor) -> torch.Tensor:
        """Return (b,) values of (b, 1, inputs); the probability is a factor as of Gardner et al., ICML 2014."""
        # BoTorch draws the worth of what violates a constraint from torch's global state, anew at every call.
        with torch.random.fork_rng(devices=[]):
            torch.random.default_generator.manual_seed(0)
            value = self._acquisition(X)
        x = X[..., 0, : self._dimension]
        return value if self._feasibility is None else value + self._feasibility.log_chance(x)


def starting_points(
    model: InstanceMeanGP,
    seed: int,
    everywhere_count: int = GLOBAL_POINTS,
    count: int = LOCAL_POINTS,
    near_to: Floats | None = None,
) -> Floats:
    """Return (n, d) positions in the unit cube at which the search for the acquisition function's maximum begins.

    ``everywhere_count`` of them lie anywhere and ``count`` near the (m, d) ``near_to``; None: those run with the best posterior means.
    """
    d = model.space.dimension
    cube = torch.stack([torch.zeros(d), torch.ones(d)]).to(torch.float64)
    everywhere = draw_sobol_samples(cube, everywhere_count, 1, seed=seed).squeeze(1).numpy()
    if near_to is None:
        near_to = best_of(model, model.promising(BASELINE))
    best = near_to[np.arange(count) % len(near_to)]
    rng = np.random.default_rng(seed)
    smallest, largest = LOCAL_SD
    sd = np.exp(rng.uniform(math.log(smallest), math.log(largest), (count, 1)))
    near = best + sd * rng.standard_normal((count, d))
    # Some coordinates stay: in many dimensions moving all of them at once leads nowhere.
    stay = rng.random(near.shape) < rng.random((count, 1))
    near[stay] = best[stay]
    near = model.space.redraw_choices(near, best, rng)
    return np.concatenate([everywhere, np.clip(near, 0.0, 1.0)])


def best_of(model: InstanceMeanGP, unit: Floats) -> Floats:
    """Return those `LOCAL_BEST` of (n, d) unit positions with the best posterior means, best first."""
    best: Floats = unit[np.argsort(-model.means(unit))[:LOCAL_BEST]]
    return best


def _gradient_starts(
    points: Floats, order: Sequence[int], discrete: Sequence[int]
) -> list[tuple[dict[int, float], list[int]]]:
    """Return ``(fixed coordinates, starting points)`` of each gradient search; one per discrete combination."""
    if not discrete:
        return [({}, list(order[:RESTARTS]))]
    climbs: dict[tuple[float, ...], list[int]] = {}
    for index in order:
        combination = tuple(float(points[index, i]) for i in discrete)
        if combination in climbs or len(climbs) < DISCRETE_COMBINATIONS:
            climbs.setdefault(combination, []).append(index)
    return [(dict(zip(discrete, c)), chosen[:2]) for c, chosen in climbs.items()]


class LogNoisyImprovement(AcquisitionFunction):
    """Logarithm of the expected improvement over the best of ``baseline``, (r, inputs), by joint ``draws``.

    BoTorch's ``qLogNoisyExpectedImprovement`` computes the posterior of all that is run and in flight again for every point
    it is asked for. Here what is true there is drawn once, and a point costs its own covariances: the values are the same.

    The root of the joint covariance of outcomes and baseline is [[A, 0], [B, C]]; a point's covariances with both, whitened by it,
    give the point's mean in every draw and what is left of its variance.
    """

    def __init__(self, model: SingleTaskGP, baseline: torch.Tensor, draws: int, seed: int) -> None:
        super().__init__(model)
        with torch.no_grad():
            model(baseline[:1])  # makes the prediction strategy
            x, kernel, mean = model.train_inputs[0], model.covar_module, model.mean_module
            noisy = psd_safe_cholesky(model.prediction_strategy.lik_train_train_covar.to_dense())
            across = torch.linalg.solve_triangular(noisy, kernel(x, baseline).to_dense(), upper=False)
            prior = kernel(baseline).to_dense()
            jitter = _JITTER * prior.diagonal().mean() * torch.eye(len(baseline), dtype=x.dtype)
            root = psd_safe_cholesky(prior - across.T @ across + jitter)
            residual = (model.train_targets - mean(x))[:, None]
            told = torch.linalg.solve_triangular(noisy, residual, upper=False)
            normal = draw_sobol_normal_samples(len(baseline) + 1, draws, dtype=x.dtype, seed=seed).T
            drawn = mean(baseline)[:, None] + across.T @ told + root @ normal[:-1]
            self._inputs = torch.cat([x, baseline])
            above = torch.cat([noisy, torch.zeros_like(across)], dim=1)
            self._root = torch.cat([above, torch.cat([across.T, root], dim=1)])
            self._whitened = torch.cat([told.expand(-1, draws), normal[:-1]])
            self._residual, self._best = normal[-1], drawn.max(dim=0).values

    def forward(self, X: torch.Tensor) -> torch.Tensor:
        """Return (b,) values of (b, 1, inputs)."""
        x, model = X[..., 0, :], self.model
        covariances = model.covar_module(self._inputs, x).to_dense()
        half = torch.linalg.solve_triangular(self._root, covariances, upper=False)
        variance = model.covar_module(x, diag=True) - half.square().sum(dim=0)
        sd = variance.clamp_min(_SMALLEST_VARIANCE).sqrt()
        drawn = (model.mean_module(x) + sd * self._residual[:, None]) + self._whitened.T @ half
        value: torch.Tensor = logmeanexp(log_fatplus(drawn - self._best[:, None], tau=TAU_RELU), dim=0)
        return value
