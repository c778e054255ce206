"""Log noisy expected improvement of one point more, whatever has been flown and is in flight (Ament et al., NeurIPS 2023).

BoTorch's ``qLogNoisyExpectedImprovement`` computes the posterior of all that is flown and in flight again for every point it is
asked for. Here what is true there is drawn once, and a point costs its own covariances: the values are the same.
"""

from __future__ import annotations

import torch
from botorch.acquisition import AcquisitionFunction
from botorch.acquisition.logei import TAU_RELU
from botorch.models import SingleTaskGP
from botorch.utils.safe_math import log_fatplus, logmeanexp
from botorch.utils.sampling import draw_sobol_normal_samples
from linear_operator.utils.cholesky import psd_safe_cholesky

_JITTER = 1e-6  # of the variance: configurations in flight may be nearly alike
_SMALLEST_VARIANCE = 1e-8


class LogNoisyImprovement(AcquisitionFunction):
    """Logarithm of the expected improvement over the best of ``baseline``, (r, inputs), by joint ``draws``.

    The root of the joint covariance of outcomes and baseline is [[A, 0], [B, C]]; a point's covariances with both, whitened by it,
    give the point's mean in every draw and what is left of its variance.
    """

    def __init__(self, model: SingleTaskGP, baseline: torch.Tensor, draws: int, seed: int) -> None:
        super().__init__(model)
        with torch.no_grad():
            model(baseline[:1])  # makes the prediction strategy
            x, kernel, mean = model.train_inputs[0], model.covar_module, model.mean_module
            noisy = psd_safe_cholesky(model.prediction_strategy.lik_train_train_covar.to_dense())
            across = torch.linalg.solve_triangular(noisy, kernel(x, baseline).to_dense(), upper=False)
            prior = kernel(baseline).to_dense()
            jitter = _JITTER * prior.diagonal().mean() * torch.eye(len(baseline), dtype=x.dtype)
            own = psd_safe_cholesky(prior - across.T @ across + jitter)
            residual = (model.train_targets - mean(x))[:, None]
            told = torch.linalg.solve_triangular(noisy, residual, upper=False)
            normal = draw_sobol_normal_samples(len(baseline) + 1, draws, dtype=x.dtype, seed=seed).T
            drawn = mean(baseline)[:, None] + across.T @ told + own @ normal[:-1]
            self._inputs = torch.cat([x, baseline])
            above = torch.cat([noisy, torch.zeros_like(across)], dim=1)
            self._root = torch.cat([above, torch.cat([across.T, own], dim=1)])
            self._whitened = torch.cat([told.expand(-1, draws), normal[:-1]])
            self._residual, self._best = normal[-1], drawn.max(dim=0).values

    def forward(self, X: torch.Tensor) -> torch.Tensor:
        """Return (b,) values of (b, 1, inputs)."""
        x, model = X[..., 0, :], self.model
        covariances = model.covar_module(self._inputs, x).to_dense()
        half = torch.linalg.solve_triangular(self._root, covariances, upper=False)
        variance = model.covar_module(x, diag=True) - half.square().sum(dim=0)
        sd = variance.clamp_min(_SMALLEST_VARIANCE).sqrt()
        drawn = (model.mean_module(x) + sd * self._residual[:, None]) + self._whitened.T @ half
        value: torch.Tensor = logmeanexp(log_fatplus(drawn - self._best[:, None], tau=TAU_RELU), dim=0)
        return value
