"""The covariance of missions, a sum of GPyTorch's kernels.

    k = s^2 m(x, x') + b^2 [same instance] + c^2 [same block] + t^2 l(x, x')

m is Matern-5/2 with a length scale per ordered parameter, times BoTorch's categorical kernel of the choices. b^2 and c^2
are the variances of what all missions in an instance, that is, on a rock under a condition, or on one (instance, replicate) block,
share. l is the covariance of a linear trend, scaled so that t^2 is its mean variance over the cube.

Inputs are (..., d + 2): the unit cube, then the instance's and the block's column of exact whole numbers. ``NO_OFFSET`` there is
the mean over instances, or blocks, that were not run: it shares nothing, not even with itself.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import torch
from botorch.models.kernels import CategoricalKernel
from botorch.utils.constraints import LogTransformedInterval
from gpytorch.kernels import Kernel, LinearKernel, MaternKernel, ScaleKernel
from gpytorch.priors import HalfCauchyPrior, LogNormalPrior

NO_OFFSET = -1.0
MIN_LENGTHSCALE = 2.5e-2
_LARGEST = 1.6e5  # of any length or variance; 1 / this is the smallest variance

# Medians and spreads of log-normal priors; outcomes are standardised, inputs are in the unit cube.
LENGTH_MEDIAN, LENGTH_SPREAD = 0.3, 0.8  # over the square root of the number of ordered parameters
LENGTH_LEAST = 0.7  # of the median: with few parameters there are missions enough to say otherwise
VARIANCE = (2.0, 1.0)  # of f
# Wide: a rock's centre is the mean of a few configurations and may be off by a standard deviation.
INSTANCE_VARIANCE = (1.0, 1.0)
# Wider still: measured blocks differ by anything from nothing to several times what parameters do.
BLOCK_VARIANCE = (0.3, 1.5)
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
    ordered: Sequence[int],
    categorical: Sequence[int],
    *,
    blocks: bool,
    tau: float | None,
) -> Kernel:
    """Return the covariance k of two missions, as the equation at the top of this module has it, with its priors.

    ``ordered`` and ``categorical`` are the columns of parameters. ``blocks``: whether the sum has the term
    with c^2; ``tau``: with t^2, and the length scales have a `SparseLengthPrior`.
    """
    f, instance_column = _landscape(ordered, categorical, tau), len(ordered) + len(categorical)
    instance = SharedLevel(active_dims=[instance_column])
    kernel = _scaled(f, *VARIANCE) + _scaled(instance, *INSTANCE_VARIANCE)
    if blocks:
        kernel = kernel + _scaled(SharedLevel(active_dims=[instance_column + 1]), *BLOCK_VARIANCE)
    if tau is not None:
        prior, mode = log_normal(*TREND_VARIANCE)
        constraint = _between(1 / _LARGEST, mode)
        kernel = kernel + Trend(
            variance_prior=prior, variance_constraint=constraint, active_dims=list(ordered)
        )
    return kernel


def landscape_kernel(ordered: Sequence[int], categorical: Sequence[int]) -> Kernel:
    """Return s^2 m alone, with its priors."""
    return _scaled(_landscape(ordered, categorical, None), *VARIANCE)


def _landscape(ordered: Sequence[int], categorical: Sequence[int], tau: float | None) -> Kernel:
    factors: list[Kernel] = []
    if ordered:
        prior, mode = log_normal(max(LENGTH_LEAST, LENGTH_MEDIAN * math.sqrt(len(ordered))), LENGTH_SPREAD)
        if tau is not None:
            prior, mode = SparseLengthPrior(tau), tau**-0.5
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
        prior, mode = log_normal(1.0, 1.0)
        factors.append(
            CategoricalKernel(
                ard_num_dims=len(categorical),
                active_dims=list(categorical),
                lengthscale_prior=prior,
                lengthscale_constraint=_between(1 / _LARGEST, mode),
            )
        )
    return factors[0] if len(factors) == 1 else factors[0] * factors[1]


def _scaled(base: Kernel, median: float, spread: float) -> ScaleKernel:
    prior, mode = log_normal(median, spread)
    return ScaleKernel(base, outputscale_prior=prior, outputscale_constraint=_between(1 / _LARGEST, mode))


def _between(low: float, begin: float) -> LogTransformedInterval:
    """Return a constraint under which a length or variance is searched on a logarithmic scale."""
    return LogTransformedInterval(low, _LARGEST, initial_value=begin)
