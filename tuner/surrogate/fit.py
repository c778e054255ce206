"""Fitting the Gaussian process: the most likely hyperparameters, by BoTorch."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from botorch.exceptions.errors import ModelFittingError
from botorch.fit import fit_gpytorch_mll
from botorch.models import SingleTaskGP
from botorch.utils.constraints import LogTransformedInterval
from gpytorch.kernels import Kernel
from gpytorch.likelihoods import GaussianLikelihood
from gpytorch.mlls import ExactMarginalLogLikelihood

from tuner.surrogate.kernel import MIN_NOISE_VARIANCE, NOISE_VARIANCE, log_normal

MAX_ITERATIONS = 75
# With fewer missions the marginal likelihood says nothing about seven hyperparameters; they stay at the priors' modes.
MIN_OBSERVATIONS_TO_FIT = 4


def fitted(kernels: Sequence[Kernel], x: torch.Tensor, y: torch.Tensor) -> SingleTaskGP:
    """Return the model with the kernel, of those given, whose fit has the largest posterior density.

    ``x`` (n, d + 2) and ``y`` (n, 1).
    """
    models = [_fitted(kernel, x, y) for kernel in kernels]
    model, _ = max(models, key=lambda found: found[1])
    return model.requires_grad_(False)


def _fitted(kernel: Kernel, x: torch.Tensor, y: torch.Tensor) -> tuple[SingleTaskGP, float]:
    """Return a fitted model and its log posterior density."""
    prior, mode = log_normal(*NOISE_VARIANCE)
    likelihood = GaussianLikelihood(
        noise_prior=prior,
        noise_constraint=LogTransformedInterval(MIN_NOISE_VARIANCE, 1e5, initial_value=mode),
    )
    # Outcomes are standardised per rock already; nothing may rescale the last columns of the inputs either.
    model = SingleTaskGP(x, y, likelihood=likelihood, covar_module=kernel, outcome_transform=None)
    mll = ExactMarginalLogLikelihood(likelihood, model)
    if len(x) >= MIN_OBSERVATIONS_TO_FIT:
        begin = {name: value.clone() for name, value in model.state_dict().items()}
        try:
            # One search from the priors' modes; where it ends is where the model stays, warnings or not.
            fit_gpytorch_mll(
                mll,
                max_attempts=1,
                warning_handler=lambda warning: True,
                optimizer_kwargs={"options": {"maxiter": MAX_ITERATIONS}},
            )
        except ModelFittingError:  # a campaign goes on by its priors
            model.load_state_dict(begin)
    mll.train()
    with torch.no_grad():
        density = float(mll(model(x), model.train_targets)) * len(x)
    model.eval()
    return model, density
