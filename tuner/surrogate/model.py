"""Gaussian process over configurations: what the missions so far say about every configuration.

Outcomes are standardised per rock (``tuner.problem.objective.RockStandardiser``). The model is then

    z(x, rock, replicate) = f(x) + b(rock) + c(rock, replicate) + noise

with a Matern-5/2 ARD kernel for f on the unit cube and an independent offset b per rock: with a handful of
missions on each rock the standardisation cannot know whether a rock is hard or was flown with poor
configurations; the offsets, inferred together with f, can. Missions on one (rock, replicate) slot also share
the arrival errors of the seed orbit, which can move all of them together by more than configurations differ:
the offset c, nested in the rock's, makes slots blocks, so that configurations are compared within them and
the offset cancels. The mean over rocks has c = 0: it is the mean over replicates nobody has flown. What rocks
do not share beyond offsets and a scale ends up in the noise, which is right for a mean over rocks.

The length-scale prior grows with the square root of the dimension (Hvarfner et al., ICML 2024), but is
narrower than theirs, there is an output scale, and the noise prior expects noise: missions are noisy, and on
synthetic data as noisy as the signal these choices were the better calibrated ones. ``SurrogateSettings`` has what
may be added: rocks' own landscapes, a sparse prior, a linear trend;
``tuner.samplers.earlier_missions`` the landscape of a cheaper fidelity or of other rocks.
"""

from __future__ import annotations

import collections
import contextlib
import dataclasses
import math
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import gpytorch
import numpy as np
import torch
from botorch.exceptions import BotorchWarning, InputDataWarning, OptimizationWarning
from botorch.models import SingleTaskGP
from gpytorch.constraints import GreaterThan
from gpytorch.likelihoods import GaussianLikelihood
from threadpoolctl import threadpool_limits

from nbv.types import Floats
from tuner.problem.objective import RockStandardiser
from tuner.problem.observations import Observation
from tuner.problem.options import Risk
from tuner.problem.search_space import SearchSpace
from tuner.samplers.earlier_missions import EarlierMissions
from tuner.surrogate.fit import (
    MIN_NOISE_VARIANCE,
    NOISE,
    Fit,
    Hyperparameters,
    InverseSquareHalfCauchy,
    LogNormal,
    Prior,
    set_parameters,
)
from tuner.surrogate.kernel import NO_OFFSET, MissionKernel
from tuner.surrogate.risk import risk_of

RISK_DRAWS = 4000
FIT_MAX_ITERATIONS = 75
# With fewer observations the marginal likelihood says nothing about seven hyperparameters; keep the priors'.
MIN_OBSERVATIONS_TO_FIT = 4
NORMAL_95 = 1.959963984540054


@contextlib.contextmanager
def numerics(seed: int) -> Iterator[None]:
    """Seeded torch, one thread everywhere, without warnings about tiny data sets; restores the random state.

    More threads than one make matrices of this size slower, several times so on a busy machine.
    """
    threads = torch.get_num_threads()
    state = torch.random.get_rng_state()
    torch.set_num_threads(1)
    torch.manual_seed(seed)
    try:
        with threadpool_limits(1), warnings.catch_warnings():
            for category in (InputDataWarning, OptimizationWarning, BotorchWarning, RuntimeWarning):
                warnings.simplefilter("ignore", category)
            yield
    finally:
        torch.set_num_threads(threads)
        torch.random.set_rng_state(state)


def tensor(array: Floats | Sequence[Sequence[float]] | Sequence[Floats]) -> torch.Tensor:
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


@dataclass(frozen=True)
class SurrogateSettings:
    """What the model is made of; each default is there by an ablation (``docs/results/optimiser_ablation.md``)."""

    slots: bool = True  # an offset per (rock, replicate), as soon as the data can tell it from rock and noise
    deviations: bool = False  # each rock departs from the common landscape, not only by an offset
    rock_scales: bool = True  # outcomes are standardised by each rock's own spread, not by the pooled one
    sparse: bool = False  # most parameters are expected to be without effect (SAAS prior, MAP over four tau)
    trend: bool = False  # a linear trend beside f's other part, one slope per ordered parameter
    trend_median: float = 2.0  # of the trend's variance
    length_median: float = 0.3  # median of the length-scale prior over sqrt(number of ordered parameters)
    length_least: float = 0.7  # but not below this: with few parameters there are missions enough to say so
    length_spread: float = 0.8
    variance_median: float = 2.0  # of f, outcomes standardised
    variance_spread: float = 1.0
    noise_median: float = 0.2  # variance, outcomes standardised
    noise_spread: float = 1.0
    starts: int = 1  # searches for the hyperparameters


SPARSE_TAUS = (1e-3, 1e-2, 1e-1, 1.0)


def moments(posterior: Any) -> tuple[Floats, Floats]:
    """``(mean, covariance)`` of a joint posterior, (m,) and (m, m)."""
    return posterior.distribution.mean.numpy(), posterior.distribution.covariance_matrix.numpy()


class RockMeanGP:
    """The Gaussian process described above; predicts the mean over the training rocks.

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
    settings
        What the model is made of.
    earlier
        Missions flown before, elsewhere, whose landscape may explain part of this one.
    """

    def __init__(
        self,
        space: SearchSpace,
        observations: Sequence[Observation],
        rocks: Sequence[str],
        seed: int = 0,
        settings: SurrogateSettings | None = None,
        earlier: EarlierMissions | None = None,
    ) -> None:
        self.settings = settings or SurrogateSettings()
        self.earlier = earlier if earlier is not None and earlier.usable else None
        feasible = [o for o in observations if o.outcome is not None]
        if not feasible:
            raise ValueError("no feasible observation to learn from")
        self.space = space
        self.rocks = tuple(rocks)
        self.observations = tuple(feasible)
        outcomes = np.array([o.outcome for o in feasible], dtype=float)
        observed_rocks = [o.rock for o in feasible]
        flown = [(o.rock, o.replicate) for o in feasible]
        self.models_slots = self.settings.slots and slots_identifiable(flown)
        self.standardiser = RockStandardiser.fit(
            observed_rocks, outcomes, shrink_centres=False, blocks=flown if self.models_slots else None
        )
        if not self.settings.rock_scales:
            self.standardiser = dataclasses.replace(self.standardiser, scales={})
        self.unit = np.array([space.to_unit(o.values) for o in feasible])  # (n, d)
        self.targets = self.standardiser.standardise(observed_rocks, outcomes)  # (n,)
        names = dict.fromkeys([*self.rocks, *observed_rocks])
        self._index = {name: float(i) for i, name in enumerate(names)}
        self._slot_index = {slot: float(i) for i, slot in enumerate(dict.fromkeys(flown))}
        columns = np.array([(self._index[rock], self._slot_index[rock, k]) for rock, k in flown])
        self._columns = columns
        with numerics(seed):
            self.model = self._assemble(*self._fit(seed))

    @property
    def _fits(self) -> bool:
        """Whether there are missions enough to look for hyperparameters; before, all stay at their priors' modes."""
        return len(self.targets) >= MIN_OBSERVATIONS_TO_FIT

    def _inputs_flown(self) -> torch.Tensor:
        """(n, d + 2) model inputs of the missions."""
        return tensor(np.column_stack([self.unit, self._columns]))

    def _ordered(self) -> list[int]:
        """Columns of the ordered parameters."""
        return [i for i in range(self.space.dimension) if i not in self.space.categorical_dimensions]

    def _kernel(self, options: Mapping[str, Any]) -> MissionKernel:
        return MissionKernel(
            self._ordered(), self.space.categorical_dimensions, self.space.dimension, **options
        )

    def _fit(self, seed: int) -> tuple[dict[str, Any], Fit]:
        """The kernel's options and its most likely hyperparameters."""
        x, s = self._inputs_flown().numpy(), self.settings
        iterations = FIT_MAX_ITERATIONS if self._fits else 0
        candidates = []
        for feature in (None,) if self.earlier is None else (None, self.earlier.feature):
            options = {
                "slots": self.models_slots, "deviations": s.deviations, "trend": s.trend, "feature": feature,
            }  # fmt: skip
            fits = []
            for tau in SPARSE_TAUS if s.sparse else (None,):
                priors = self._priors(len(self._ordered()), tau)
                belief = Hyperparameters(self._kernel(options), x, self.targets, priors)
                found = belief.fit(starts=s.starts, seed=seed, iterations=iterations)
                fits.append(found)
            fit = max(fits, key=lambda f: f.log_posterior)
            # One more parameter has to earn its place (Schwarz's criterion).
            penalty = 0.5 * math.log(len(self.targets)) if feature is not None else 0.0
            candidates.append((fit.log_evidence - penalty, options, fit))
        _, options, fit = max(candidates, key=lambda c: c[0])
        return options, fit

    def _assemble(self, options: Mapping[str, Any], fit: Fit) -> SingleTaskGP:
        """The Gaussian process with fitted hyperparameters."""
        kernel = self._kernel(options)
        set_parameters(kernel, fit)
        likelihood = GaussianLikelihood(noise_constraint=GreaterThan(MIN_NOISE_VARIANCE / 2, transform=None))
        # Standardised already; nothing may rescale the last columns either.
        model = SingleTaskGP(
            self._inputs_flown(), tensor(self.targets[:, None]), likelihood=likelihood, covar_module=kernel,
            outcome_transform=None,
        )  # fmt: skip
        likelihood.noise = torch.tensor(math.exp(fit.log_noise_variance), dtype=torch.float64)
        constant = model.mean_module.constant
        constant.data = torch.tensor(fit.mean, dtype=torch.float64).reshape(constant.shape)
        model.eval()
        return model.requires_grad_(False)

    def _priors(self, ordered: int, tau: float | None) -> dict[str, Prior]:
        s = self.settings
        median = max(s.length_least, s.length_median * math.sqrt(max(1, ordered)))
        length: Prior = LogNormal(math.log(median), s.length_spread)
        if tau is not None:
            length = InverseSquareHalfCauchy(tau)
        return {
            "log_lengthscale": length,
            "log_choice_length": LogNormal(0.0, 1.0),
            "log_variance": LogNormal(math.log(s.variance_median), s.variance_spread),
            # Wide: a rock's centre is the mean of a few configurations and may be off by a standard deviation.
            "log_rock_variance": LogNormal(0.0, 1.0),
            # Wider still: measured slots differ by anything from nothing to several times what parameters do.
            "log_slot_variance": LogNormal(math.log(0.3), 1.5),
            "log_deviation": LogNormal(math.log(0.3), 1.0),
            "log_trend_variance": LogNormal(math.log(s.trend_median), 1.0),
            "log_feature_variance": LogNormal(math.log(0.5), 1.0),
            NOISE: LogNormal(math.log(s.noise_median), s.noise_spread),
        }

    @property
    def uses_earlier(self) -> bool:
        """Whether the earlier missions' landscape is part of the model: the missions flown prefer it so."""
        return self.model.covar_module.feature is not None

    @property
    def virtual_rock(self) -> float:
        """Rock column of no rock: its offset is 0, so configurations are compared by f alone."""
        return NO_OFFSET

    def rock_level(self, rock: str) -> float:
        """Rock column of a known rock."""
        return self._index[rock]

    def slot_level(self, rock: str, replicate: int | None) -> float:
        """Slot column of a (rock, replicate); one that has not been flown has an offset nobody knows."""
        unknown = float(len(self._slot_index))
        return unknown if replicate is None else self._slot_index.get((rock, replicate), unknown)

    def inputs(self, unit: Floats, rock: float | None = None, slot: float | None = None) -> torch.Tensor:
        """(m, d + 2) model inputs for (m, d) unit positions; without rock and slot offsets unless told."""
        tail = [self.virtual_rock if rock is None else rock, NO_OFFSET if slot is None else slot]
        return tensor(np.column_stack([unit, np.tile(tail, (len(unit), 1))]))

    def posterior(self, values: Sequence[Mapping[str, Any]], risk: Risk = "mean") -> Posterior:
        """Joint posterior of the mean (or of a risk measure) over the training rocks at the configurations.

        A risk measure is not Gaussian: its mean and covariance are those of ``RISK_DRAWS`` joint draws.
        """
        unit = np.array([self.space.to_unit(v) for v in values])
        m, count = len(unit), len(self.rocks)
        x = torch.cat([self.inputs(unit, self._index[rock]) for rock in self.rocks])
        with torch.no_grad(), gpytorch.settings.fast_pred_var(False):
            joint_mean, joint_covariance = moments(self.model.posterior(x))
        mean, covariance = joint_mean.reshape(count, m), joint_covariance.reshape(count, m, count, m)
        scales = np.array([self.standardiser.scale(rock) for rock in self.rocks])
        centres = np.array([self.standardiser.centre(rock) for rock in self.rocks])
        if risk == "mean":
            return Posterior(
                centres.mean() + scales @ mean / count,
                np.einsum("r,s,rmsn->mn", scales, scales, covariance) / count**2,
            )
        draws = np.random.default_rng(0).multivariate_normal(
            joint_mean, joint_covariance, RISK_DRAWS, check_valid="ignore", method="eigh"
        )
        outcomes = draws.reshape(-1, count, m).transpose(0, 2, 1) * scales + centres
        measured = risk_of(torch.from_numpy(outcomes), risk).numpy()
        return Posterior(measured.mean(axis=0), np.atleast_2d(np.cov(measured, rowvar=False)))

    def predict_mission(
        self, values: Mapping[str, Any], rock: str, replicate: int | None = None
    ) -> tuple[float, float]:
        """``(mean, sd)`` of the outcome of one new mission on a known rock, its noise included.

        On the slot of a ``replicate`` flown before, what that slot taught is used; any other replicate, or
        None, is a slot like the others whose offset is not known.
        """
        slot = self.slot_level(rock, replicate)
        with torch.no_grad():
            x = self.inputs(self.space.to_unit(values)[None], self._index[rock], slot)
            centre, covariance = moments(self.model.posterior(x, observation_noise=True))
            mean, sd = float(centre[0]), math.sqrt(float(covariance[0, 0]))
        scale = self.standardiser.scale(rock)
        return self.standardiser.centre(rock) + scale * mean, scale * sd

    def predict_on_rock(self, values: Mapping[str, Any], rock: str) -> float:
        """Posterior mean outcome of one configuration on one known rock, in the objective's unit."""
        return self.predict_mission(values, rock)[0]

    @property
    def noise_sd(self) -> float:
        """Standard deviation of one mission's outcome beside its slot's offset, objective's unit."""
        return math.sqrt(self.model.likelihood.noise.item()) * self.mean_scale

    @property
    def slot_sd(self) -> float | None:
        """Standard deviation of the (rock, replicate) offsets, objective's unit; None where not modelled."""
        if not self.models_slots:
            return None
        return math.sqrt(self.model.covar_module.slot_variance) * self.mean_scale

    @property
    def mean_scale(self) -> float:
        """Objective's unit per unit of the common landscape, mean over the training rocks."""
        return float(np.mean([self.standardiser.scale(rock) for rock in self.rocks]))

    @property
    def lengthscales(self) -> dict[str, float]:
        """Length scale per ordered parameter, in unit-cube units; long means unimportant."""
        ordered = [p.path for p in self.space.parameters if p.kind != "categorical"]
        lengths = self.model.covar_module.log_lengthscale.exp()
        return dict(zip(ordered, lengths.tolist()))

    def leave_one_out(self) -> LooCheck:
        """Leave-one-out check from the inverse training covariance (Rasmussen and Williams, Eq. 5.10-12)."""
        model = self.model
        with torch.no_grad():
            x = model.train_inputs[0]
            prior = model.forward(x)
            noise = model.likelihood.noise.unsqueeze(-1) * torch.eye(x.shape[-2], dtype=x.dtype)
            inverse = torch.linalg.inv(prior.covariance_matrix + noise)
            diagonal = inverse.diagonal(dim1=-2, dim2=-1)
            residual = (inverse @ (model.train_targets - prior.mean).unsqueeze(-1)).squeeze(-1) / diagonal
        return LooCheck(self.targets, (model.train_targets - residual).numpy(), (1 / diagonal).sqrt().numpy())


def slots_identifiable(slots: Sequence[tuple[str, int]]) -> bool:
    """Whether missions on these (rock, replicate) slots can tell slot offsets from rock offsets and noise.

    Some rock must have been flown with two replicates, and some slot twice on a rock that has another one.
    """
    missions = collections.Counter(slots)
    per_rock = collections.Counter(rock for rock, _ in missions)
    return any(count > 1 and per_rock[rock] > 1 for (rock, _), count in missions.items())
