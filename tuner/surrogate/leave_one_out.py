"""Missions predicted from all others: how far the model can be trusted where it has data."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
from botorch.models import SingleTaskGP

from nbv.types import Floats
from tuner.surrogate.numerics import NORMAL_95


@dataclass(frozen=True)
class LooCheck:
    """Leave-one-out predictions of the standardised outcomes, hyperparameters kept."""

    observed: Floats  # (n,)
    mean: Floats  # (n,)
    sd: Floats  # (n,) of a new observation, noise included

    @property
    def z(self) -> Floats:
        """(n,) standardised residuals."""
        return (self.observed - self.mean) / self.sd

    @property
    def coverage_95(self) -> float:
        """Share of observations inside their central 95 % predictive interval."""
        return float(np.mean(np.abs(self.z) <= NORMAL_95))

    @property
    def rmse(self) -> float:
        """Root mean square error, in standardised units."""
        return float(np.sqrt(np.mean((self.observed - self.mean) ** 2)))

    @property
    def log_density(self) -> float:
        """Mean log predictive density."""
        return float(np.mean(-0.5 * self.z**2 - np.log(self.sd) - 0.5 * math.log(2 * math.pi)))

    def to_dict(self) -> dict[str, float]:
        """The figures for a report."""
        return {
            "observations": len(self.observed),
            "coverage_95": self.coverage_95,
            "z_sd": float(np.std(self.z)),
            "rmse": self.rmse,
            "log_density": self.log_density,
        }


def leave_one_out(model: SingleTaskGP) -> LooCheck:
    """The check, from the inverse training covariance (Rasmussen and Williams, Eq. 5.10-12)."""
    with torch.no_grad():
        x, y = model.train_inputs[0], model.train_targets
        noise = model.likelihood.noise * torch.eye(len(x), dtype=x.dtype)
        inverse = torch.linalg.inv(model.covar_module(x).to_dense() + noise)
        diagonal = inverse.diagonal()
        residual = inverse @ (y - model.mean_module(x)) / diagonal
    return LooCheck(y.numpy(), (y - residual).numpy(), (1 / diagonal).sqrt().numpy())
