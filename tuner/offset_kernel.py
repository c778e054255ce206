"""Kernel of random offsets: what all missions on one rock, or on one (rock, replicate) slot, share."""

from __future__ import annotations

from typing import Any

import torch
from gpytorch.constraints import GreaterThan
from gpytorch.kernels import Kernel, ScaleKernel
from gpytorch.priors import LogNormalPrior

# The level of an input that carries no offset.
NO_OFFSET = -1.0


class OffsetKernel(Kernel):
    """1 where both inputs carry the same level, else 0; ``NO_OFFSET`` shares nothing, not even with itself.

    Acts on one column (``active_dims``) of exact whole numbers. Scaled by tau^2 it is the covariance of
    independent offsets b(level) ~ N(0, tau^2). An input at ``NO_OFFSET`` has b = 0: the mean over levels
    nobody has seen.
    """

    has_lengthscale = False

    def forward(self, x1: torch.Tensor, x2: torch.Tensor, diag: bool = False, **params: Any) -> torch.Tensor:
        """``(..., n, m)`` covariance of ``(..., n, 1)`` and ``(..., m, 1)`` levels; ``(..., n)`` if ``diag``."""
        one, two = x1[..., 0], x2[..., 0]
        if not diag:
            one, two = one.unsqueeze(-1), two.unsqueeze(-2)
        return ((one == two) & (one >= 0)).to(x1.dtype)


def offset_variance(column: int, prior: LogNormalPrior, initial: float) -> ScaleKernel:
    """The kernel above on ``column``, times a variance with ``prior``."""
    return ScaleKernel(
        OffsetKernel(active_dims=[column]),
        outputscale_prior=prior,
        outputscale_constraint=GreaterThan(1e-4, transform=None, initial_value=initial),
    )
