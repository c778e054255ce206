"""The expected saving of a deterministic cost by a mission, where the quality has an outcome constraint.

A cheaper configuration counts once it meets the constraint with the probability `SURE`. Before a mission, with the
posterior mean m, variance v and noise variance t of the quality, the mean after it is normal with mean m and variance
v^2 / (v + t), the variance after it v t / (v + t); so the probability that it will count has a closed form. It times what
it saves over the cheapest that counts is the value. (The noisy expected improvement is over the cheapest of each draw
instead: among many configurations near the limit one keeps it in almost every draw, and the search goes on below.)
"""

from __future__ import annotations

import torch
from botorch.acquisition import AcquisitionFunction

from tuner.surrogate.model import InstanceMeanGP
from tuner.surrogate.posterior import DeterministicOutcome

RECENT = 8
_LEAST = 1e-12


class LogExpectedSaving(AcquisitionFunction):
    """Logarithm of the expected saving.

    ``model``: of the quality. ``cost``: larger is better, as everywhere. ``at_least``: the limit of the quality's
    mean over the training instances. ``quantile``: standard deviations above the limit from which on it counts as
    kept. ``best``: the outcome of the cheapest configuration that counts as keeping it. ``running``: (m, inputs) in
    flight: they may become the cheapest, and the last `RECENT` will reduce the uncertainty near them.
    """

    def __init__(
        self,
        model: InstanceMeanGP,
        cost: DeterministicOutcome,
        at_least: float,
        quantile: float,
        best: float,
        running: torch.Tensor | None,
    ) -> None:
        super().__init__(model.model)
        self._cost, self._at_least, self._quantile = cost, at_least, quantile
        self._recent: torch.Tensor | None = None
        self._gp, self._noise = model, model.noise_sd**2
        levels, chances = [best], [1.0]
        if running is not None:
            with torch.no_grad():
                chance = self._log_chance(running.unsqueeze(1)).exp()
            for level, p in sorted(zip(cost.at(running).tolist(), chance.tolist())):
                if level > best:
                    levels.append(level)
                    chances.append(p)
            self._recent = running[-RECENT:]
        # The best level reached: each with the probability that none above it is.
        none_above, weights = 1.0, []
        for p in reversed(chances):
            weights.append(none_above * p)
            none_above *= 1.0 - p
        self._levels = torch.tensor(levels[::-1], dtype=torch.float64)
        self._weights = torch.tensor(weights, dtype=torch.float64)

    def forward(self, X: torch.Tensor) -> torch.Tensor:
        """Return (b,) values of (b, 1, inputs)."""
        saved = (self._cost.at(X[:, 0])[:, None] - self._levels).clamp_min(0.0) @ self._weights
        return saved.clamp_min(_LEAST).log() + self._log_chance(X)

    def _log_chance(self, X: torch.Tensor) -> torch.Tensor:
        """Return (b,) log probabilities, of (b, 1, inputs), that after a mission the limit will count as kept."""
        points = X
        if self._recent is not None:
            points = torch.cat([X, self._recent.expand(len(X), *self._recent.shape)], dim=1)
        q = points.shape[1]
        means, covariance = self._gp.mean_over_instances(points)
        mean, variance = means[:, 0], covariance[:, 0, 0]
        if q > 1:
            across = covariance[:, 1:, :1]
            noisy = covariance[:, 1:, 1:] + self._noise * torch.eye(q - 1, dtype=X.dtype)
            variance = variance - (across * torch.linalg.solve(noisy, across)).sum((1, 2))
        variance = variance.clamp_min(_LEAST * self._noise)
        after = (variance * self._noise / (variance + self._noise)).sqrt()
        moved = variance / (variance + self._noise).sqrt()
        log_chance: torch.Tensor = torch.special.log_ndtr(
            (mean - self._at_least - self._quantile * after) / moved
        )
        return log_chance
