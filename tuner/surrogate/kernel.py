"""The covariance of missions, as one kernel.

    k = s^2 m(x, x') (1 + delta [same rock]) + b^2 [same rock] + c^2 [same slot] + t^2 l(x, x') + v^2 g(x) g(x')

m is Matern-5/2 with a length scale per ordered parameter, times exp(-mean of mismatches / length) over the
choices. b^2 and c^2 are the variances of what all missions on a rock or on one (rock, replicate) slot share.
delta is the share by which a rock's own landscape departs from the common one: an intrinsic coregionalisation
model whose rocks are exchangeable, so that one number describes all correlations, 1 / (1 + delta). l is the
covariance of a linear trend with a slope per ordered parameter, scaled so that t^2 is the trend's mean variance over
the cube. g is a given function of the configuration, such as the landscape of missions flown before (``tuner.samplers.earlier_missions``).

Inputs are (..., d + 2): the unit cube, then the rock's and the slot's column of exact whole numbers.
``NO_OFFSET`` there is the mean over rocks, or slots, that nobody has flown: it shares nothing, not even with
itself. One kernel instead of a sum of library kernels: an evaluation takes a fraction of the time.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import torch
from gpytorch.kernels import Kernel

NO_OFFSET = -1.0
_SQRT5 = math.sqrt(5.0)
# Squared distances below this have no gradient; the kernel is flat there.
_TINY = 1e-20


class MissionKernel(Kernel):
    """The kernel above; all parameters are logarithms, so that they need no constraints.

    Parameters
    ----------
    ordered, categorical
        Columns of the ordered parameters and of the choices.
    rock_column
        The rock's column; the slot's is the next one.
    slots, deviations, trend
        Whether c^2, delta and t^2 are there.
    feature
        g, of (..., n, d + 2) inputs: (..., n); None where there is none.
    """

    has_lengthscale = False
    is_stationary = False

    def __init__(
        self,
        ordered: Sequence[int],
        categorical: Sequence[int],
        rock_column: int,
        *,
        slots: bool,
        deviations: bool,
        trend: bool = False,
        feature: Callable[[torch.Tensor], torch.Tensor] | None = None,
    ) -> None:
        super().__init__()
        self.ordered, self.categorical = list(ordered), list(categorical)
        self.rock_column = rock_column
        self.slots, self.deviations, self.trend = slots, deviations, trend and len(self.ordered) > 0
        self.log_lengthscale = _parameter(len(self.ordered))
        self.log_choice_length = _parameter(len(self.categorical))
        self.log_variance = _parameter()
        self.log_rock_variance = _parameter()
        if slots:
            self.log_slot_variance = _parameter()
        if deviations:
            self.log_deviation = _parameter()
        if self.trend:
            self.log_trend_variance = _parameter()
        self.feature = feature
        if feature is not None:
            self.log_feature_variance = _parameter()

    @property
    def slot_variance(self) -> float:
        """c^2; 0 where it is not modelled."""
        return math.exp(self.log_slot_variance.item()) if self.slots else 0.0

    def correlation(self, x1: torch.Tensor, x2: torch.Tensor, diag: bool) -> torch.Tensor:
        """m: ``(..., n, m)``, or ``(..., n)`` where ``diag``."""
        scale = self.log_lengthscale.exp().unsqueeze(-2)
        a, b = x1[..., self.ordered] / scale, x2[..., self.ordered] / scale
        if diag:
            squared = ((a - b) ** 2).sum(-1)
        else:
            squared = (
                (a**2).sum(-1).unsqueeze(-1) + (b**2).sum(-1).unsqueeze(-2) - 2 * a @ b.transpose(-1, -2)
            )
        r = _SQRT5 * squared.clamp_min(_TINY).sqrt()
        m = (1 + r + r**2 / 3) * (-r).exp()
        if self.categorical:
            one, two = x1[..., self.categorical], x2[..., self.categorical]
            if not diag:
                one, two = one.unsqueeze(-2), two.unsqueeze(-3)
            mismatch = ((one - two).abs() > 1e-9).to(m.dtype)
            length = self.log_choice_length.exp().unsqueeze(-2)
            if not diag:
                length = length.unsqueeze(-2)
            m = m * (-(mismatch / length).mean(-1)).exp()
        return m

    def linear_terms(self, x: torch.Tensor) -> dict[str, torch.Tensor]:
        """What f is linear in, by the name of its coefficients' variance: ``(..., n, p)`` of ``(..., n, d + 2)``."""
        terms = {}
        if self.trend:
            terms["log_trend_variance"] = math.sqrt(12.0 / len(self.ordered)) * (x[..., self.ordered] - 0.5)
        if self.feature is not None:
            terms["log_feature_variance"] = self.feature(x).unsqueeze(-1)
        return terms

    def forward(self, x1: torch.Tensor, x2: torch.Tensor, diag: bool = False, **params: Any) -> torch.Tensor:
        """``(..., n, m)`` covariance of ``(..., n, d + 2)`` and ``(..., m, d + 2)``; ``(..., n)`` if ``diag``."""
        same_rock = _same(x1, x2, self.rock_column, diag)

        def wide(log_value: torch.Tensor) -> torch.Tensor:
            value = log_value.exp().unsqueeze(-1)
            return value if diag else value.unsqueeze(-1)

        m = wide(self.log_variance) * self.correlation(x1, x2, diag)
        k = m + wide(self.log_rock_variance) * same_rock
        if self.deviations:
            k = k + wide(self.log_deviation) * m * same_rock
        if self.slots:
            k = k + wide(self.log_slot_variance) * _same(x1, x2, self.rock_column + 1, diag)
        one, two = self.linear_terms(x1), self.linear_terms(x2)
        for name in one:
            product = (one[name] * two[name]).sum(-1) if diag else one[name] @ two[name].transpose(-1, -2)
            k = k + wide(getattr(self, name)) * product
        return k


def _parameter(*shape: int) -> torch.nn.Parameter:
    return torch.nn.Parameter(torch.zeros(shape, dtype=torch.float64))


def _same(x1: torch.Tensor, x2: torch.Tensor, column: int, diag: bool) -> torch.Tensor:
    one, two = x1[..., column], x2[..., column]
    if not diag:
        one, two = one.unsqueeze(-1), two.unsqueeze(-2)
    return ((one == two) & (one >= 0)).to(x1.dtype)
