"""Fitting Gaussian processes: the most likely hyperparameters, by BoTorch.

Beyond `EXACT_MISSIONS` hyperparameters are fitted to `FITTED_MISSIONS` drawn from all, and the model has seen those and the
`PROMISING` best by what they say, where a search goes on: `docs/results/data/large_ledger.csv` compares it with the exact model.
"""

from __future__ import annotations

import contextlib
import math
import threading
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from botorch.acquisition.utils import prune_inferior_points
from botorch.exceptions import BotorchWarning, InputDataWarning, OptimizationWarning
from botorch.exceptions.errors import ModelFittingError
from botorch.fit import fit_gpytorch_mll
from botorch.models import SingleTaskGP
from botorch.models.kernels import CategoricalKernel
from botorch.models.model import Model
from botorch.sampling import SobolQMCNormalSampler
from botorch.utils.constraints import LogTransformedInterval
from gpytorch.kernels import Kernel, LinearKernel, MaternKernel, ScaleKernel
from gpytorch.likelihoods import GaussianLikelihood
from gpytorch.mlls import ExactMarginalLogLikelihood
from gpytorch.priors import HalfCauchyPrior, LogNormalPrior
from scipy import special
from threadpoolctl import threadpool_limits

from nbv.types import Floats, Ints
from tuner.problem.search_space import SearchSpace

# The covariance of missions, a sum of GPyTorch's kernels.
#
#     k = s^2 m(x, x') + b^2 [same instance] + c^2 [same block] + t^2 l(x, x') + sum over scorers of u^2 w(x, x') h(x, x')
#
# m is Matern-5/2 with a length scale per ordered parameter, times BoTorch's categorical kernel of the choices. b^2 and c^2
# are the variances of what all missions in an instance, that is, on a rock under a condition, or on one (instance, replicate) block,
# share. l is the covariance of a linear trend, scaled so that t^2 is its mean variance over the cube; w that of a trend in the
# share of a scorer's main weight, and h a categorical kernel of the choices: another scorer, another slope.
#
# Inputs are (..., d + 2): the unit cube, then the instance's and the block's column of exact whole numbers. ``NO_OFFSET`` there is
# the mean over instances, or blocks, that were not run: it shares nothing, not even with itself.


NO_OFFSET = -1.0
MIN_LENGTHSCALE = 2.5e-2
BesideMain = Sequence[tuple[list[int], Floats, float]]  # a scorer's columns of weights, ranges, main weight
_LARGEST = 1.6e5  # of any length or variance; 1 / this is the smallest variance

# Medians and spreads of log-normal priors; outcomes are standardised, inputs are in the unit cube.
LENGTH_MEDIAN, LENGTH_SPREAD = 0.3, 0.8  # over the square root of the number of ordered parameters
LENGTH_LEAST = 0.7  # of the median: with few parameters there are missions enough to say otherwise
VARIANCE = (2.0, 1.0)  # of f
# Wide: a rock's centre is the mean of a few configurations and may be off by a standard deviation.
INSTANCE_VARIANCE = (1.0, 1.0)
# Wider still: measured blocks differ by anything from nothing to several times what parameters do.
BLOCK_VARIANCE = (0.3, 1.5)
SPARSE_TAU = 1.0  # of 0.001 to 1: the most likely from 100 missions on, and as good with fewer
TREND_VARIANCE = (2.0, 1.0)
NOISE_VARIANCE, MIN_NOISE_VARIANCE = (0.2, 1.0), 1e-4


class SharedLevel(Kernel):
    """1 where two inputs have the same level of one column, else 0; ``NO_OFFSET`` is no level."""

    def forward(self, x1: torch.Tensor, x2: torch.Tensor, diag: bool = False, **params: Any) -> torch.Tensor:
        """Return (..., n, m) of (..., n, 1) and (..., m, 1) columns; (..., n) if ``diag``."""
        one, two = x1[..., 0], x2[..., 0]
        if not diag:
            one, two = one.unsqueeze(-1), two.unsqueeze(-2)
        return ((one == two) & (one >= 0)).to(x1.dtype)


class Trend(LinearKernel):
    """Linear in all its columns about the cube's centre; its variance is the mean over the cube."""

    def forward(self, x1: torch.Tensor, x2: torch.Tensor, diag: bool = False, **params: Any) -> torch.Tensor:
        """Return (..., n, m) of (..., n, p) and (..., m, p); (..., n) if ``diag``."""
        scale = math.sqrt(12.0 / x1.shape[-1])
        return super().forward(scale * (x1 - 0.5), scale * (x2 - 0.5), diag=diag, **params)


class MainShare(Trend):
    """Linear, about a half, in the share of a scorer's main term in the sum of its weights.

    Where any other weight is large the main term decides little: in logarithms of weights that is all but one corner, in this share
    a line. ``ranges``: (p, 2) of the other weights, whose columns are on a logarithmic scale.
    """

    def __init__(self, ranges: Floats, main: float, **options: Any) -> None:
        super().__init__(**options)
        self._low, self._high, self._main = *tensor(np.log(ranges)).unbind(dim=-1), main

    def forward(self, x1: torch.Tensor, x2: torch.Tensor, diag: bool = False, **params: Any) -> torch.Tensor:
        """Return (..., n, m) of (..., n, p) and (..., m, p); (..., n) if ``diag``."""
        return super().forward(self._share(x1), self._share(x2), diag=diag, **params)

    def _share(self, x: torch.Tensor) -> torch.Tensor:
        others = (self._low + x * (self._high - self._low)).exp().sum(dim=-1, keepdim=True)
        return self._main / (self._main + others)


class SparseLengthPrior(HalfCauchyPrior):
    """Sparse axis-aligned prior: 1 / length^2 ~ HalfCauchy(tau) (Eriksson and Jankowiak, UAI 2021).

    Most length scales go to infinity, that is, most parameters are switched off, unless the data object. A density over
    the logarithm of the length, unlike BoTorch's ``add_saas_prior``: it has a mode, at tau^-1/2.
    """

    def log_prob(self, length: torch.Tensor) -> torch.Tensor:
        inverse_square = length**-2
        return super().log_prob(inverse_square) + inverse_square.log()


def log_normal(median: float, spread: float) -> tuple[LogNormalPrior, float]:
    """Return the prior and its mode, where the search for hyperparameters begins."""
    return LogNormalPrior(math.log(median), spread), median * math.exp(-(spread**2))


def mission_kernel(
    ordered: Sequence[int], categorical: Sequence[int], *, blocks: bool, sparse: bool, beside_main: BesideMain
) -> Kernel:
    """Return the covariance k of two missions, as the equation above has it, with its priors.

    ``ordered`` and ``categorical`` are the columns of parameters. ``blocks``: whether the sum has the term
    with c^2; ``sparse``: with t^2 and u^2, and the length scales have a `SparseLengthPrior`, where parameters are ordered.
    """
    f, instance_column = _landscape(ordered, categorical, sparse=sparse), len(ordered) + len(categorical)
    instance = SharedLevel(active_dims=[instance_column])
    kernel = _scaled(f, *VARIANCE) + _scaled(instance, *INSTANCE_VARIANCE)
    if blocks:
        kernel = kernel + _scaled(SharedLevel(active_dims=[instance_column + 1]), *BLOCK_VARIANCE)
    if sparse and ordered:
        prior, mode = log_normal(*TREND_VARIANCE)
        options = {"variance_prior": prior, "variance_constraint": _between(1 / _LARGEST, mode)}
        kernel = kernel + Trend(**options, active_dims=list(ordered))
        for columns, ranges, main in beside_main:
            share: Kernel = MainShare(ranges, main, **options, active_dims=columns)
            kernel = kernel + (share * _choices(categorical) if categorical else share)
    return kernel


def landscape_kernel(ordered: Sequence[int], categorical: Sequence[int]) -> Kernel:
    """Return s^2 m alone, with its priors."""
    return _scaled(_landscape(ordered, categorical, sparse=False), *VARIANCE)


def _landscape(ordered: Sequence[int], categorical: Sequence[int], *, sparse: bool) -> Kernel:
    factors: list[Kernel] = []
    if ordered:
        prior, mode = log_normal(max(LENGTH_LEAST, LENGTH_MEDIAN * math.sqrt(len(ordered))), LENGTH_SPREAD)
        if sparse:
            prior, mode = SparseLengthPrior(SPARSE_TAU), SPARSE_TAU**-0.5
        factors.append(
            MaternKernel(
                nu=2.5,
                ard_num_dims=len(ordered),
                active_dims=list(ordered),
                lengthscale_prior=prior,
                lengthscale_constraint=_between(MIN_LENGTHSCALE, mode),
            )
        )
    if categorical:
        factors.append(_choices(categorical))
    return factors[0] if len(factors) == 1 else factors[0] * factors[1]


def _choices(categorical: Sequence[int]) -> Kernel:
    prior, mode = log_normal(1.0, 1.0)
    return CategoricalKernel(
        ard_num_dims=len(categorical),
        active_dims=list(categorical),
        lengthscale_prior=prior,
        lengthscale_constraint=_between(1 / _LARGEST, mode),
    )


def _scaled(base: Kernel, median: float, spread: float) -> ScaleKernel:
    prior, mode = log_normal(median, spread)
    return ScaleKernel(base, outputscale_prior=prior, outputscale_constraint=_between(1 / _LARGEST, mode))


def _between(low: float, begin: float) -> LogTransformedInterval:
    """Return a constraint under which a length or variance is searched on a logarithmic scale."""
    return LogTransformedInterval(low, _LARGEST, initial_value=begin)


# Numerical conventions: float64, one thread, one computation at a time, and random generators of its own.


PRUNING_SAMPLES = 2048
NORMAL_95 = 1.959963984540054


_turn = threading.RLock()


@contextlib.contextmanager
def numerics() -> Iterator[None]:
    """Take turns with other threads, use one thread, hide warnings about tiny data sets.

    BoTorch's fits change the process's warning filters, and threads and filters are the process's here too; torch's global random
    state is neither used nor changed. More threads than one make matrices of this size slower, several times so on a busy machine.
    """
    with _turn, threadpool_limits(1), warnings.catch_warnings():
        threads = torch.get_num_threads()
        torch.set_num_threads(1)
        for category in (InputDataWarning, OptimizationWarning, BotorchWarning, RuntimeWarning):
            warnings.simplefilter("ignore", category)
        try:
            yield
        finally:
            torch.set_num_threads(threads)


def pruned(model: Model, inputs: torch.Tensor, seed: int) -> torch.Tensor:
    """Return those of (n, inputs) that may be the best; as BoTorch's, whose sampler takes its seed from the global state."""
    sampler = SobolQMCNormalSampler(torch.Size([PRUNING_SAMPLES]), seed=seed)
    return prune_inferior_points(model, inputs, sampler=sampler)


def tensor(array: Floats | Sequence[Sequence[float]] | Sequence[Floats]) -> torch.Tensor:
    """float64 tensor, the only precision used here."""
    return torch.as_tensor(np.asarray(array, dtype=np.float64), dtype=torch.float64)


# The joint posterior of some configurations, and its intervals: by Student's t, not by the normal distribution.
#
# The Gaussian process is over-confident: a search proposes what the model over-estimates, and its standard deviations are
# estimates themselves.


FREEDOM = 5.0  # degrees of freedom of intervals and probabilities
CANCELLED = 1e-13  # of variances: what is left of their difference is rounding


def interval_95(mean: float, sd: float) -> tuple[float, float]:
    """Return the 95 % interval of Student's t around ``mean``, scaled by ``sd``, with `FREEDOM` degrees of freedom."""
    half = float(special.stdtrit(FREEDOM, 0.975)) * sd
    return mean - half, mean + half


def probability_positive(mean: float, sd: float) -> float:
    """Return the probability by the same distribution that a quantity is above 0; a half where ``sd`` is 0."""
    return 0.5 if sd == 0.0 else float(special.stdtr(FREEDOM, mean / sd))


@dataclass(frozen=True)
class Posterior:
    """Joint Gaussian posterior of the mean outcome over the training rocks, without observation noise.

    In the objective's unit, oriented so that larger is better.
    """

    mean: Floats  # (m,)
    covariance: Floats  # (m, m)

    @property
    def sd(self) -> Floats:
        """(m,) standard deviations."""
        return np.sqrt(np.clip(np.diag(self.covariance), 0.0, None))

    def difference(self, index: int, reference: int) -> tuple[float, float]:
        """Return ``(mean, sd)`` of entry ``index`` minus entry ``reference``."""
        c = self.covariance
        variance = c[index, index] + c[reference, reference] - 2 * c[index, reference]
        known = variance <= CANCELLED * (c[index, index] + c[reference, reference])
        return float(self.mean[index] - self.mean[reference]), 0.0 if known else math.sqrt(variance)


MAX_ITERATIONS = 75
# With fewer missions the marginal likelihood says nothing about seven hyperparameters; they stay at the priors' modes.
MIN_OBSERVATIONS_TO_FIT = 4
EXACT_MISSIONS = 600
FITTED_MISSIONS = 400
PROMISING = 300
_ROWS = 4096  # worked on at once
_LEAST_SD = 0.1  # a label apart is 2: nothing is certain


def fitted(kernel: Kernel, x: torch.Tensor, y: torch.Tensor) -> SingleTaskGP:
    """Return the model with the most likely hyperparameters; ``x`` (n, d + 2) and ``y`` (n, 1)."""
    prior, mode = log_normal(*NOISE_VARIANCE)
    likelihood = GaussianLikelihood(
        noise_prior=prior,
        noise_constraint=LogTransformedInterval(MIN_NOISE_VARIANCE, 1e5, initial_value=mode),
    )
    # Outcomes are standardised per rock already; nothing may rescale the last columns of the inputs either.
    model = SingleTaskGP(x, y, likelihood=likelihood, covar_module=kernel, outcome_transform=None)
    mll = ExactMarginalLogLikelihood(likelihood, model)
    if len(x) >= MIN_OBSERVATIONS_TO_FIT:
        begin = {name: value.clone() for name, value in model.state_dict().items()}
        try:
            # One search from the priors' modes; where it ends is where the model stays, warnings or not.
            fit_gpytorch_mll(
                mll,
                max_attempts=1,
                warning_handler=lambda warning: True,
                optimizer_kwargs={"options": {"maxiter": MAX_ITERATIONS}},
            )
        except ModelFittingError:  # a campaign goes on by its priors
            model.load_state_dict(begin)
    model.eval()
    return model.requires_grad_(False)


def fitted_subset(count: int) -> Ints:
    """Return to which of ``count`` missions the hyperparameters are fitted: to all where they are few."""
    if count <= EXACT_MISSIONS:
        return np.arange(count)
    return np.sort(np.random.default_rng(count).choice(count, FITTED_MISSIONS, replace=False))


def with_promising(model: SingleTaskGP, x: torch.Tensor, y: torch.Tensor) -> SingleTaskGP:
    """Return ``model``, fitted to some missions, as if it had seen the best of all, (n, inputs) and (n, 1), too."""
    best = posterior_means(model, x).argsort(descending=True)[:PROMISING]
    told = torch.unique(torch.cat([torch.from_numpy(fitted_subset(len(x))), best]))
    larger = SingleTaskGP(
        x[told],
        y[told],
        likelihood=model.likelihood,
        covar_module=model.covar_module,
        mean_module=model.mean_module,
        outcome_transform=None,
    )
    larger.eval()
    return larger.requires_grad_(False)


def posterior_means(model: SingleTaskGP, x: torch.Tensor) -> torch.Tensor:
    """Return (n,) posterior means at (n, inputs), without the (n, n) covariance."""
    with torch.no_grad():
        model(x[:1])  # computes the weights of the outcomes
        weights, z = model.prediction_strategy.mean_cache, model.train_inputs[0]
        return torch.cat(
            [
                model.mean_module(rows) + model.covar_module(rows, z).to_dense() @ weights
                for rows in x.split(_ROWS)
            ]
        )


class Feasibility:
    """Whether a configuration works at all: what missions that failed, and those that did not, say of every configuration.

    A Gaussian process over labels, 1 for a mission that ended well and -1 for one that the configuration failed, as Gardner et al.
    (ICML 2014) model constraints; its noise learns how much failures are chance. ``worked`` and ``failed`` are (n, d) and (m, d)
    unit positions, one a mission.
    """

    def __init__(self, space: SearchSpace, worked: Floats, failed: Floats) -> None:
        ordered = [i for i in range(space.dimension) if i not in space.categorical_dimensions]
        x = torch.cat([tensor(failed), tensor(worked)])
        y = torch.ones(len(x), 1, dtype=torch.float64)
        y[: len(failed)] = -1.0
        chosen = fitted_subset(len(x))
        with numerics(), torch.enable_grad():  # whoever asks first
            kernel = landscape_kernel(ordered, space.categorical_dimensions)
            self._model = fitted(kernel, x[chosen], y[chosen])

    def log_chance(self, unit: torch.Tensor) -> torch.Tensor:
        """Return (...,) logarithm of the probability that a mission ends well, at (..., d) unit positions; differentiable."""
        posterior = self._model(unit.unsqueeze(-2))
        mean, variance = posterior.mean[..., 0], posterior.variance[..., 0]
        return torch.special.log_ndtr(mean / (variance + _LEAST_SD**2).sqrt())
