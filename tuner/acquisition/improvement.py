"""Log noisy expected improvement of the mean over rocks, with one of its two expectations in closed form.

    log NEI(x) = log mean over s of EI(f(x) | f(B) = F_s, best = max F_s)

F_s are joint posterior draws of f, the mean over rocks, at everything flown and in flight, B. Given them the missions
say nothing more about f(x), so f(x) is Gaussian with the mean c + k(x, B) K^-1 (F_s - c) and one variance for all
draws: the expectation over f(x) is Ament et al.'s log EI (NeurIPS 2023), and what is left to Monte Carlo does not
depend on x. BoTorch's qLogNoisyExpectedImprovement samples f(x) too, to serve batches and any objective; for single
points this is the same quantity with less variance at a fifth of the time.
"""

from __future__ import annotations

import math

import numpy as np
import torch
from botorch.acquisition import AcquisitionFunction
from botorch.acquisition.analytic import _log_ei_helper
from botorch.utils.sampling import draw_sobol_normal_samples

from nbv.types import Floats
from tuner.surrogate.model import RockMeanGP

DRAWS = 128
# Of the variance of f, added to B's covariances before and after the missions alike: f is only that well known.
JITTER = 1e-6
_TINY = 1e-12


class LogNoisyImprovement(AcquisitionFunction):
    """The quantity above, at ``(batch, 1, d + 2)`` inputs of the surrogate: ``(batch,)``.

    Parameters
    ----------
    gp
        The surrogate.
    pending
        (m, d) unit positions in flight.
    seed
        Of the draws.
    """

    def __init__(self, gp: RockMeanGP, pending: Floats, seed: int) -> None:
        super().__init__(model=gp.model)
        self._kernel = gp.model.covar_module
        flown = np.unique(np.concatenate([gp.unit, pending.reshape(-1, gp.unit.shape[1])]), axis=0)
        self._at = gp.inputs(flown)  # (n, d + 2)
        with torch.no_grad():
            belief = gp.model.posterior(self._at).distribution
            mean, covariance = belief.mean, belief.covariance_matrix  # (n,), (n, n)
            self._constant = gp.model.mean_module.constant
            prior = self._kernel.forward(self._at, self._at)
            jitter = JITTER * prior.diagonal().mean() * torch.eye(len(flown))
            noise = draw_sobol_normal_samples(len(flown), DRAWS, dtype=torch.float64, seed=seed)
            draws = mean + noise @ torch.linalg.cholesky(covariance + jitter).T
            self._best = draws.amax(-1)  # (DRAWS,)
            root = torch.linalg.cholesky(prior + jitter)
            self._weights = torch.cholesky_solve((draws - self._constant).T, root)  # (n, DRAWS)
            self._whiten = torch.linalg.inv(root).T

    def forward(self, X: torch.Tensor) -> torch.Tensor:
        """See the class."""
        covariance = self._kernel.forward(X, self._at).squeeze(-2)  # (batch, n)
        mean = self._constant + covariance @ self._weights
        own = self._kernel.forward(X, X, diag=True)  # (batch, 1)
        variance = own - (covariance @ self._whiten).square().sum(-1, keepdim=True)
        sd = variance.clamp_min(_TINY).sqrt()
        log_ei = _log_ei_helper((mean - self._best) / sd) + sd.log()
        return log_ei.logsumexp(-1) - math.log(DRAWS)
