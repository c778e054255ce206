"""What a fitted surrogate believes of every configuration, as a feature of another surrogate."""

from __future__ import annotations

import torch

from tuner.surrogate.kernel import NO_OFFSET
from tuner.surrogate.model import RockMeanGP


class Landscape:
    """Posterior mean of ``gp`` at no rock, standardised over its missions: ``(..., d + 2)`` inputs to ``(..., 1)``."""

    def __init__(self, gp: RockMeanGP) -> None:
        model = gp.model
        self._d, self._kernel, self._x = gp.space.dimension, model.covar_module, model.train_inputs[0]
        with torch.no_grad():
            noise = model.likelihood.noise * torch.eye(len(self._x), dtype=torch.float64)
            residual = model.train_targets - model.mean_module.constant
            covariance = self._kernel(self._x).to_dense() + noise
            self._weights = torch.linalg.solve(covariance, residual.unsqueeze(-1))
            self._centre, self._scale = 0.0, 1.0
            level = self(gp.inputs(gp.unit))
        self._centre, self._scale = float(level.mean()), max(1e-9, float(level.std()))

    def __call__(self, x: torch.Tensor) -> torch.Tensor:
        """The columns behind the unit cube's are ignored."""
        unit = x[..., : self._d]  # another model may have other columns behind them
        nowhere = unit.new_full((*unit.shape[:-1], self._x.shape[-1] - self._d), NO_OFFSET)
        bare = torch.cat([unit, nowhere], dim=-1)
        level = self._kernel(bare, self._x).to_dense() @ self._weights
        return (level - self._centre) / self._scale
