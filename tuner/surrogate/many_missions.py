"""A model that stays small: of many missions the most telling.

Beyond `EXACT_MISSIONS` hyperparameters are fitted to `FITTED_MISSIONS` drawn from all, and the model has seen those and the
`PROMISING` best by what they say, where a search goes on. ``research/large_ledger.py`` compares it with the exact model.
"""

from __future__ import annotations

import numpy as np
import torch
from botorch.models import SingleTaskGP

from nbv.types import Ints

EXACT_MISSIONS = 600
FITTED_MISSIONS = 400
PROMISING = 300
_ROWS = 4096  # worked on at once


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
