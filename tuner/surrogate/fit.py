"""Hyperparameters of the missions' Gaussian process: maximum a posteriori, by L-BFGS on their logarithms.

The objective is the exact log marginal likelihood with the constant mean at its generalised least squares value,
plus the log densities of the priors, with analytic gradients. Written out because a general-purpose fit spends
most of its time between its layers: this one makes room for several starts in every ask.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch
from scipy.linalg import cho_solve, cholesky
from scipy.optimize import minimize

from nbv.types import Floats
from tuner.surrogate.kernel import MissionKernel

_JITTER = 1e-8
_LOG_BOUND = 12.0
_SQRT5 = math.sqrt(5.0)
MIN_NOISE_VARIANCE = 1e-4
MIN_LENGTHSCALE = 2.5e-2
NOISE = "log_noise_variance"


@dataclass(frozen=True)
class LogNormal:
    """exp of N(location, spread^2). Densities are over the quantity itself: the mode is exp(location - spread^2)."""

    location: float
    spread: float

    @property
    def log_mode(self) -> float:
        """Logarithm of the most likely value."""
        return self.location - self.spread**2

    def log_density(self, log_value: Floats) -> tuple[float, Floats]:
        """Summed over elements, up to a constant, and its gradient."""
        z = (log_value - self.location) / self.spread
        return float((-0.5 * z**2 - log_value).sum()), -z / self.spread - 1.0


@dataclass(frozen=True)
class InverseSquareHalfCauchy:
    """Sparse axis-aligned prior of length scales: 1 / length^2 ~ HalfCauchy(tau) (Eriksson and Jankowiak, UAI 2021).

    Most length scales go to infinity, that is, most parameters are switched off, unless the data object.
    """

    tau: float

    @property
    def log_mode(self) -> float:
        """Where the search begins; the density itself has its mode at infinity."""
        return -0.5 * math.log(self.tau)

    def log_density(self, log_value: Floats) -> tuple[float, Floats]:
        """Summed over elements, up to a constant, and its gradient; a density over the logarithm."""
        ratio = np.exp(-4 * log_value) / self.tau**2
        value = -2 * log_value - math.log(self.tau) - np.log1p(ratio)
        return float(value.sum()), -2 + 4 * ratio / (1 + ratio)


Prior = LogNormal | InverseSquareHalfCauchy


@dataclass(frozen=True)
class Fit:
    """Where the search ended."""

    position: Floats  # logarithms of all parameters, the noise variance last
    mean: float
    log_posterior: float  # marginal likelihood plus log priors, up to a constant
    log_evidence: float  # marginal likelihood, up to a constant

    @property
    def log_noise_variance(self) -> float:
        """The last of them."""
        return float(self.position[-1])


class Hyperparameters:
    """Posterior density of the logarithms of a kernel's parameters and of the noise variance.

    Parameters
    ----------
    x, y
        (n, d + 2) inputs and (n,) outcomes.
    priors
        By the names of the kernel's parameters, and ``NOISE``.
    """

    def __init__(self, kernel: MissionKernel, x: Floats, y: Floats, priors: Mapping[str, Prior]) -> None:
        self.slices: dict[str, slice] = {}
        begin = 0
        for name, parameter in kernel.named_parameters():
            self.slices[name] = slice(begin, begin + parameter.numel())
            begin += parameter.numel()
        self.slices[NOISE] = slice(begin, begin + 1)
        self._priors = priors
        self.low, self.high = np.full(begin + 1, -_LOG_BOUND), np.full(begin + 1, _LOG_BOUND)
        self.low[self.slices["log_lengthscale"]] = math.log(MIN_LENGTHSCALE)
        self.low[-1] = math.log(MIN_NOISE_VARIANCE)
        home = np.empty(begin + 1)
        for name, part in self.slices.items():
            home[part] = priors[name].log_mode
        self.home = np.clip(home, self.low, self.high)
        self._evidence = Evidence(kernel, x, y, self.slices)

    def log_density(self, position: Floats) -> tuple[float, Floats]:
        """Log posterior of the quantities and its gradient in their logarithms."""
        value, gradient, _ = self._evidence(position)
        for name, part in self.slices.items():
            own, slope = self._priors[name].log_density(position[part])
            value += own
            gradient[part] += slope
        return value, gradient

    def fit(self, *, starts: int = 1, seed: int = 0, iterations: int = 75) -> Fit:
        """The most likely place. The first search begins at the priors' modes, the others around them.

        With 0 ``iterations`` everything stays at the modes.
        """

        def loss(position: Floats) -> tuple[float, Floats]:
            value, gradient = self.log_density(position)
            return (-value, -gradient) if math.isfinite(value) else (1e10, np.zeros_like(position))

        rng = np.random.default_rng(seed)
        best, best_loss = self.home, loss(self.home)[0]
        for start in range(max(1, starts) if iterations else 0):
            noise = rng.normal(0.0, 0.7, len(self.home)) if start else 0.0
            end = minimize(
                loss, np.clip(self.home + noise, self.low, self.high), jac=True, method="L-BFGS-B",
                bounds=list(zip(self.low, self.high)), options={"maxiter": iterations},
            )  # fmt: skip
            if end.fun < best_loss:
                best, best_loss = end.x, float(end.fun)
        evidence, _, mean = self._evidence(best)
        return Fit(best, mean, -best_loss, evidence)


def set_parameters(kernel: MissionKernel, fit: Fit) -> None:
    """Enter fitted values."""
    begin = 0
    for parameter in kernel.parameters():
        size = parameter.numel()
        parameter.data = torch.tensor(fit.position[begin : begin + size]).reshape(parameter.shape).clone()
        begin += size


class Evidence:
    """Log marginal likelihood of ``MissionKernel``, its gradient and the mean, as a function of the logarithms."""

    def __init__(self, kernel: MissionKernel, x: Floats, y: Floats, slices: Mapping[str, slice]) -> None:
        self._y, self._slices = y, slices
        difference = x[:, None, :] - x[None, :, :]
        self._squares = np.moveaxis(difference[..., kernel.ordered] ** 2, -1, 0).copy()  # (k, n, n)
        self._mismatches = np.moveaxis(np.abs(difference[..., kernel.categorical]) > 1e-9, -1, 0).astype(
            float
        )
        self._same_rock = _shared(x[:, kernel.rock_column])
        self._same_slot = _shared(x[:, kernel.rock_column + 1])
        self._slots, self._deviations = kernel.slots, kernel.deviations
        with torch.no_grad():
            terms = kernel.linear_terms(torch.from_numpy(x))
        self._linear = {name: (term @ term.T).numpy() for name, term in terms.items()}

    def __call__(self, position: Floats) -> tuple[float, Floats, float]:
        """``(value, gradient, mean)``; value -inf where the covariance is not positive definite."""
        at = {name: np.exp(position[part]) for name, part in self._slices.items()}
        n = len(self._y)
        inverse_squares = at["log_lengthscale"] ** -2
        r = (
            _SQRT5 * np.sqrt(np.tensordot(inverse_squares, self._squares, 1))
            if len(inverse_squares)
            else np.zeros((n, n))
        )
        decay = np.exp(-r)
        choices = 1 / (at["log_choice_length"] * max(1, len(self._mismatches)))
        outer: Floats = (
            float(at["log_variance"][0]) * np.exp(-np.tensordot(choices, self._mismatches, 1))
            if len(choices)
            else np.full((n, n), float(at["log_variance"][0]))
        )
        rock = float(at["log_rock_variance"][0]) * self._same_rock
        noise = float(at[NOISE][0])
        departing = 1.0 + at["log_deviation"][0] * self._same_rock if self._deviations else 1.0
        matern = (1 + r + r**2 / 3) * decay
        common = outer * matern * departing
        covariance = common + rock
        if self._slots:
            covariance += at["log_slot_variance"][0] * self._same_slot
        for name, products in self._linear.items():
            covariance += at[name][0] * products
        covariance[np.diag_indices(n)] += noise + _JITTER
        try:
            root = cholesky(covariance, lower=True, check_finite=False)
        except np.linalg.LinAlgError:
            return -math.inf, np.zeros_like(position), 0.0
        inverse = cho_solve((root, True), np.eye(n), check_finite=False)
        row = inverse.sum(0)
        mean = float(row @ self._y / row.sum())
        weights = inverse @ (self._y - mean)
        value = -0.5 * float((self._y - mean) @ weights) - float(np.log(np.diag(root)).sum())
        # d value / d theta = tr(half (w w' - K^-1) dK / d theta)
        half = 0.5 * (np.outer(weights, weights) - inverse)
        gradient = np.empty_like(position)
        slope = half * outer * departing * (5 / 3) * (1 + r) * decay
        gradient[self._slices["log_lengthscale"]] = inverse_squares * np.tensordot(self._squares, slope, 2)
        gradient[self._slices["log_choice_length"]] = choices * np.tensordot(
            self._mismatches, half * common, 2
        )
        gradient[self._slices["log_variance"]] = (half * common).sum()
        gradient[self._slices["log_rock_variance"]] = (half * rock).sum()
        if self._slots:
            gradient[self._slices["log_slot_variance"]] = (
                at["log_slot_variance"] * (half * self._same_slot).sum()
            )
        if self._deviations:
            own = at["log_deviation"][0] * self._same_rock * outer * matern
            gradient[self._slices["log_deviation"]] = (half * own).sum()
        for name, products in self._linear.items():
            gradient[self._slices[name]] = at[name] * (half * products).sum()
        gradient[self._slices[NOISE]] = noise * np.trace(half)
        return value, gradient, mean


def _shared(levels: Floats) -> Floats:
    return ((levels[:, None] == levels[None, :]) & (levels[:, None] >= 0)).astype(float)
