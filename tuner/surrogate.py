"""Gaussian process over configurations: what the missions so far say about every configuration.

The default model ignores which rock an observation came from once outcomes are standardised per rock
(``tuner.objective.RockStandardiser``): a Matern-5/2 ARD kernel with dimension-scaled length-scale priors
(Hvarfner et al., ICML 2024) on the unit cube, and one inferred noise. What the rocks do not share ends up in
the noise, which is right for a mean over rocks.
"""

from __future__ import annotations

import contextlib
import math
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import gpytorch
import numpy as np
import torch
from botorch.exceptions import BotorchWarning, InputDataWarning, OptimizationWarning
from botorch.fit import fit_gpytorch_mll
from botorch.models import SingleTaskGP
from botorch.models.kernels.categorical import CategoricalKernel
from botorch.models.utils.gpytorch_modules import get_covar_module_with_dim_scaled_prior
from gpytorch.constraints import GreaterThan
from gpytorch.likelihoods import GaussianLikelihood
from gpytorch.priors import LogNormalPrior

from nbv.types import Floats
from tuner.history import Observation
from tuner.objective import RockStandardiser
from tuner.search_space import SearchSpace

FIT_MAX_ITERATIONS = 75
# With fewer observations the marginal likelihood says nothing about seven hyperparameters; keep the priors'.
MIN_OBSERVATIONS_TO_FIT = 4
NORMAL_95 = 1.959963984540054


@contextlib.contextmanager
def numerics(seed: int) -> Iterator[None]:
    """Seeded, single-threaded torch, without warnings about tiny data sets; restores the random state."""
    threads = torch.get_num_threads()
    state = torch.random.get_rng_state()
    torch.set_num_threads(1)
    torch.manual_seed(seed)
    try:
        with warnings.catch_warnings():
            for category in (InputDataWarning, OptimizationWarning, BotorchWarning, RuntimeWarning):
                warnings.simplefilter("ignore", category)
            yield
    finally:
        torch.set_num_threads(threads)
        torch.random.set_rng_state(state)


def tensor(array: Floats | Sequence[Sequence[float]]) -> torch.Tensor:
    """float64 tensor, the only precision used here."""
    return torch.as_tensor(np.asarray(array, dtype=np.float64), dtype=torch.float64)


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


@dataclass(frozen=True)
class Posterior:
    """Joint Gaussian belief about the mean outcome over the training rocks, without observation noise.

    In the objective's unit, oriented so that larger is better.
    """

    mean: Floats  # (m,)
    covariance: Floats  # (m, m)

    @property
    def sd(self) -> Floats:
        """(m,)"""
        return np.sqrt(np.clip(np.diag(self.covariance), 0.0, None))

    def difference(self, index: int, reference: int) -> tuple[float, float]:
        """``(mean, sd)`` of entry ``index`` minus entry ``reference``."""
        c = self.covariance
        variance = c[index, index] + c[reference, reference] - 2 * c[index, reference]
        return float(self.mean[index] - self.mean[reference]), math.sqrt(max(0.0, float(variance)))

    def probability_best(self, indices: Sequence[int], seed: int, samples: int = 20_000) -> Floats:
        """(len(indices),) probability that each is the best of them, by joint sampling."""
        pick = np.asarray(indices)
        covariance = self.covariance[np.ix_(pick, pick)]
        rng = np.random.default_rng(seed)
        draws = rng.multivariate_normal(
            self.mean[pick], covariance, samples, check_valid="ignore", method="eigh"
        )
        return np.bincount(draws.argmax(axis=1), minlength=len(pick)) / samples


class RockMeanGP:
    """``SingleTaskGP`` on per-rock-standardised outcomes; predicts the mean over the training rocks.

    Parameters
    ----------
    space
        The search space.
    observations
        Finished missions; failed ones are left out. At least one must be feasible.
    rocks
        The training rocks over which the mean is taken.
    seed
        Seed of the fit.
    """

    def __init__(
        self, space: SearchSpace, observations: Sequence[Observation], rocks: Sequence[str], seed: int = 0
    ) -> None:
        feasible = [o for o in observations if o.outcome is not None]
        if not feasible:
            raise ValueError("no feasible observation to learn from")
        self.space = space
        self.rocks = tuple(rocks)
        self.observations = tuple(feasible)
        outcomes = np.array([o.outcome for o in feasible], dtype=float)
        observed_rocks = [o.rock for o in feasible]
        self.standardiser = RockStandardiser.fit(observed_rocks, outcomes)
        self.unit = np.array([space.to_unit(o.values) for o in feasible])  # (n, d)
        self.targets = self.standardiser.standardise(observed_rocks, outcomes)  # (n,)
        self._offset, self._factor = self.standardiser.mean_over(self.rocks)
        with numerics(seed):
            self.model = self._build()
            if len(feasible) >= MIN_OBSERVATIONS_TO_FIT:
                mll = gpytorch.mlls.ExactMarginalLogLikelihood(self.model.likelihood, self.model)
                fit_gpytorch_mll(mll, optimizer_kwargs={"options": {"maxiter": FIT_MAX_ITERATIONS}})
            self.model.eval()

    def _build(self) -> SingleTaskGP:
        d = self.space.dimension
        categorical = self.space.categorical_dimensions
        ordered = [i for i in range(d) if i not in categorical]
        kernels = []
        if ordered:
            kernels.append(
                get_covar_module_with_dim_scaled_prior(
                    len(ordered), use_rbf_kernel=False, active_dims=ordered
                )
            )
        if categorical:
            kernels.append(CategoricalKernel(ard_num_dims=len(categorical), active_dims=list(categorical)))
        kernel = kernels[0] if len(kernels) == 1 else kernels[0] * kernels[1]
        # Outcomes have unit spread within a rock, and missions are noisy: a prior median of 0.1 with a wide
        # spread (BoTorch's own, median 0.018, makes small noisy data sets overconfident).
        noise_prior = LogNormalPrior(math.log(0.1), 1.5)
        likelihood = GaussianLikelihood(
            noise_prior=noise_prior,
            noise_constraint=GreaterThan(1e-4, transform=None, initial_value=0.1),
        )
        # The outcomes are standardised already; X has no rock column, so nothing may rescale it.
        return SingleTaskGP(
            tensor(self.unit),
            tensor(self.targets[:, None]),
            likelihood=likelihood,
            covar_module=kernel,
            outcome_transform=None,
        )

    def posterior(self, values: Sequence[Mapping[str, Any]]) -> Posterior:
        """Joint posterior of the rock mean at the given configurations."""
        unit = tensor(np.array([self.space.to_unit(v) for v in values]))
        with torch.no_grad(), gpytorch.settings.fast_pred_var(False):
            joint = self.model.posterior(unit).distribution
            mean = joint.mean.numpy()
            covariance = joint.covariance_matrix.numpy()
        return Posterior(self._offset + self._factor * mean, self._factor**2 * covariance)

    def predict_on_rock(self, values: Mapping[str, Any], rock: str) -> float:
        """Posterior mean outcome of one configuration on one rock, in the objective's unit."""
        with torch.no_grad():
            z = self.model.posterior(tensor([self.space.to_unit(values)])).mean.item()
        return self.standardiser.centre(rock) + self.standardiser.scale(rock) * z

    @property
    def noise_sd(self) -> float:
        """Standard deviation of one mission's outcome about its configuration's rock mean, objective's unit."""
        return float(math.sqrt(self.model.likelihood.noise.item())) * self._factor

    @property
    def lengthscales(self) -> dict[str, float]:
        """Length scale per ordered parameter, in unit-cube units; long means unimportant."""
        kernel = self.model.covar_module
        for part in getattr(kernel, "kernels", [kernel]):
            if isinstance(part, gpytorch.kernels.MaternKernel):
                ordered = [p.path for p in self.space.parameters if p.kind != "categorical"]
                return dict(zip(ordered, part.lengthscale.detach().flatten().tolist()))
        return {}

    def leave_one_out(self) -> LooCheck:
        """Leave-one-out check from the inverse training covariance (Rasmussen and Williams, Eq. 5.10-12)."""
        model = self.model
        with torch.no_grad():
            x = model.train_inputs[0]
            prior = model.forward(x)
            noisy = prior.covariance_matrix + model.likelihood.noise * torch.eye(len(x), dtype=x.dtype)
            inverse = torch.linalg.inv(noisy)
            residual = (inverse @ (model.train_targets - prior.mean)) / inverse.diagonal()
            observed = model.train_targets.numpy()
            return LooCheck(observed, observed - residual.numpy(), inverse.diagonal().rsqrt().numpy())
