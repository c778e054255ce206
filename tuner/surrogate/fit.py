"""Hyperparameters of the missions' Gaussian process: maximum a posteriori, by L-BFGS on their logarithms.

The objective is the exact log marginal likelihood with the constant mean at its generalised least squares value,
plus the log densities of the priors, with analytic gradients. Written out because a general-purpose fit spends
most of its time between its layers: this one makes room for several starts in every ask.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from scipy.linalg import cho_solve, cholesky
from scipy.optimize import minimize

from nbv.types import Floats
from tuner.surrogate.kernel import MissionKernel

_JITTER = 1e-8
_WARM_UP, _THINNING, _LEAPFROGS = 12, 4, 5
_LOG_BOUND = 12.0
_SQRT5 = math.sqrt(5.0)
MIN_NOISE_VARIANCE = 1e-4
MIN_LENGTHSCALE = 2.5e-2
NOISE = "log_noise_variance"
TAU_SCALE = 0.1
TAU_GRID = tuple(float(tau) for tau in np.logspace(-4, 1, 31))


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


def draw_tau(log_lengths: Floats, rng: np.random.Generator) -> InverseSquareHalfCauchy:
    """The sparse prior with tau drawn given the length scales, tau ~ HalfCauchy(0.1) on a logarithmic grid."""
    log_weights = [
        math.log(tau) - math.log1p((tau / TAU_SCALE) ** 2)
        + InverseSquareHalfCauchy(tau).log_density(log_lengths)[0]
        for tau in TAU_GRID
    ]  # fmt: skip
    weights = np.exp(np.array(log_weights) - max(log_weights))
    return InverseSquareHalfCauchy(float(rng.choice(TAU_GRID, p=weights / weights.sum())))


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

    def log_density(self, position: Floats, *, over_logarithms: bool = False) -> tuple[float, Floats]:
        """Log posterior and its gradient; over the quantities, or over their logarithms."""
        value, gradient, _ = self._evidence(position)
        for name, part in self.slices.items():
            prior = self._priors[name]
            own, slope = prior.log_density(position[part])
            if over_logarithms and isinstance(prior, LogNormal):
                own, slope = own + float(position[part].sum()), slope + 1.0
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

    def sample(self, begin: Fit, count: int, seed: int) -> list[Fit]:
        """``count`` draws by Hamiltonian Monte Carlo over the logarithms, from ``begin`` on.

        Steps are scaled by the curvature at the beginning. Bounds reflect nothing: a trajectory that leaves them
        is refused. A sparse prior's tau is drawn in turn with the rest (Gibbs), and left at its last draw.
        """
        rng = np.random.default_rng(seed)
        lengths = self.slices["log_lengthscale"]
        sparse = isinstance(self._priors["log_lengthscale"], InverseSquareHalfCauchy)
        at = begin.position.copy()
        value, gradient = self.log_density(at, over_logarithms=True)
        scale = self._scales(at)
        step, draws = 0.35, []
        for turn in range(_WARM_UP + count * _THINNING):
            if sparse and lengths.stop > lengths.start:
                self._priors = {**self._priors, "log_lengthscale": draw_tau(at[lengths], rng)}
                value, gradient = self.log_density(at, over_logarithms=True)
            momentum = rng.standard_normal(len(at))
            energy = value - 0.5 * momentum @ momentum
            new, new_value, new_gradient = at.copy(), value, gradient
            for _ in range(_LEAPFROGS):
                momentum = momentum + 0.5 * step * scale * new_gradient
                new = new + step * scale * momentum
                if np.any(new < self.low) or np.any(new > self.high):
                    new_value = -math.inf
                    break
                new_value, new_gradient = self.log_density(new, over_logarithms=True)
                if not math.isfinite(new_value):
                    break
                momentum = momentum + 0.5 * step * scale * new_gradient
            gain = new_value - 0.5 * momentum @ momentum - energy
            accepted = math.log(rng.random()) < gain if math.isfinite(gain) else False
            if accepted:
                at, value, gradient = new, new_value, new_gradient
            if turn < _WARM_UP:  # towards three acceptances in four
                step *= 1.1 if accepted else 0.75
            elif (turn - _WARM_UP) % _THINNING == _THINNING - 1:
                evidence, _, mean = self._evidence(at)
                draws.append(Fit(at, mean, value, evidence))
        return draws

    def _scales(self, at: Floats) -> Floats:
        """One over the root of the curvature, at least that of a broad prior."""
        h = 1e-3
        curvature = np.empty(len(at))
        for i in range(len(at)):
            ahead, behind = at.copy(), at.copy()
            ahead[i] += h
            behind[i] -= h
            forward = self.log_density(ahead, over_logarithms=True)[1][i]
            backward = self.log_density(behind, over_logarithms=True)[1][i]
            curvature[i] = -(forward - backward) / (2 * h)
        usable = np.nan_to_num(curvature, nan=1.0)
        result: Floats = 1 / np.sqrt(np.clip(usable, 0.5, 1e4))
        return result


def set_parameters(kernel: MissionKernel, fits: Sequence[Fit]) -> None:
    """Enter fitted values; several for an ensemble."""
    begin = 0
    positions = np.array([fit.position for fit in fits])
    lead = len(kernel.batch_shape)
    for parameter in kernel.parameters():
        size = parameter.numel() // len(fits) if lead else parameter.numel()
        block = torch.tensor(positions[:, begin : begin + size])
        parameter.data = (block if lead else block[0]).reshape(parameter.shape).clone()
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
