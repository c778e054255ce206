"""A model that stays small: many missions, condensed into what they say at a few hundred inducing ones.

Beyond `EXACT_MISSIONS` hyperparameters are fitted to `FITTED_MISSIONS` drawn from all, and all missions are condensed by the
fully independent training conditional (Snelson and Ghahramani, NIPS 2005; Quiñonero-Candela and Rasmussen, JMLR 2005): given
the landscape u at the inducing missions Z, the others are independent. The result is the posterior of an exact process that saw
pseudo-outcomes at Z under correlated noise,

    S = (I / s^2 + W L^-1 W')^-1,   y_Z = S (y(Z) / s^2 + W L^-1 y(R)),   W = K_ZZ^-1 K_ZR,   L = s^2 + k_RR - diag(K_RZ W)

(R the rest, s^2 the noise), so that everything built on an exact Gaussian process goes on as it is. The cost is linear in the
missions. ``research/large_ledger.py`` compares it with the exact model.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from botorch.models import SingleTaskGP
from gpytorch.likelihoods import GaussianLikelihood
from linear_operator.operators import DenseLinearOperator

from nbv.types import Ints

EXACT_MISSIONS = 600
FITTED_MISSIONS = 400
PROMISING = 300  # inducing missions beside those: the best by what the fitted ones say
_ROWS = 4096  # worked on at once
_JITTER = 1e-6  # of the variance, for the inverse of K_ZZ


class _CondensedNoise(GaussianLikelihood):
    """Correlated noise of the pseudo-outcomes at the inducing inputs; one mission's noise anywhere else."""

    def __init__(self, noise: torch.Tensor, inputs: torch.Tensor, covariance: torch.Tensor) -> None:
        super().__init__()
        self.noise = noise
        self._inputs, self._covariance = inputs, covariance

    def _shaped_noise_covar(self, base_shape: torch.Size, *params: Any, **kwargs: Any) -> Any:
        inputs = params[0][0] if params and isinstance(params[0], (list, tuple)) else next(iter(params), None)
        if inputs is not None and torch.equal(inputs, self._inputs):
            return DenseLinearOperator(self._covariance)
        return super()._shaped_noise_covar(base_shape, *params, **kwargs)


def fitted_subset(count: int) -> Ints:
    """Return to which of ``count`` missions the hyperparameters are fitted: to all where they are few."""
    if count <= EXACT_MISSIONS:
        return np.arange(count)
    return np.sort(np.random.default_rng(count).choice(count, FITTED_MISSIONS, replace=False))


def condensed(model: SingleTaskGP, x: torch.Tensor, y: torch.Tensor) -> SingleTaskGP:
    """Return ``model``, fitted to some missions, as if it had seen all: (n, inputs) and (n, 1). Hyperparameters stay.

    The inducing missions are those of ``model`` and the best by its means, where a search goes on.
    """
    y = y[:, 0]
    with torch.no_grad():
        promise = posterior_means(model, x).argsort(descending=True)[:PROMISING]
        z = torch.unique(torch.cat([model.train_inputs[0], x[promise]]), dim=0)
        kernel, mean = model.covar_module, model.mean_module
        s2 = model.likelihood.noise.detach()
        own = kernel(z).to_dense()
        jitter = _JITTER * own.diagonal().mean() * torch.eye(len(own), dtype=own.dtype)
        factor = torch.linalg.cholesky(own + jitter)
        precision = torch.zeros(len(z), len(z), dtype=x.dtype)
        told = torch.zeros(len(z), dtype=x.dtype)
        for rows, outcomes in zip(x.split(_ROWS), y.split(_ROWS)):
            k = kernel(z, rows).to_dense()
            weights = torch.cholesky_solve(k, factor)  # a mission at Z has weight 1 there
            noise = s2 + (kernel(rows, diag=True) - (k * weights).sum(0)).clamp_min(0.0)
            precision += (weights / noise) @ weights.T
            told += weights @ ((outcomes - mean(rows)) / noise)
        # Every inducing input is a mission's, so this is at least the identity over s^2.
        inverse = torch.linalg.cholesky(precision)
        covariance = torch.cholesky_inverse(inverse)
        pseudo = mean(z) + torch.cholesky_solve(told[:, None], inverse)[:, 0]
    small = SingleTaskGP(
        z,
        pseudo[:, None],
        likelihood=_CondensedNoise(s2, z, covariance),
        covar_module=kernel,
        mean_module=mean,
        outcome_transform=None,
    )
    small.eval()
    return small.requires_grad_(False)


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
