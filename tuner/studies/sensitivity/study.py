"""Which parameters matter: Sobol indices of the surrogate, with Optuna's importances beside them."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import gpytorch
import numpy as np
import optuna
import torch
from optuna.importance import (
    FanovaImportanceEvaluator,
    PedAnovaImportanceEvaluator,
    get_param_importances,
)

from nbv.errors import UserError
from nbv.types import Floats
from tuner.problem.search_space import SearchSpace
from tuner.problem.standardise import RockStandardiser
from tuner.problem.worlds import World
from tuner.samplers.distributions import distributions
from tuner.studies.missions_as_data import MissionData
from tuner.studies.sensitivity.sobol import (
    Pair,
    SobolIndices,
    bootstrap_interval,
    main_effect_map,
    sobol_design,
    sobol_indices,
)
from tuner.surrogate.model import RockMeanGP
from tuner.surrogate.numerics import numerics

GATE_PAIR = ("gate.budget_fraction", "gate.d95_m")
MEAN_SAMPLES = 2048  # rows of the design for the posterior mean
DRAW_SAMPLES = 256  # and for posterior draws, which need a joint covariance
DRAWS = 128
RESAMPLES = 512
MAP_GRID = 24
MAP_SAMPLES = 256
_CHUNK = 4096


@dataclass(frozen=True)
class Surrogate:
    """The GP's belief about a configuration's mean outcome over the rocks, on the unit cube.

    Integers and choices settle to their values. Objective's unit, as measured (not negated).
    """

    gp: RockMeanGP
    sign: float

    def mean(self, unit: Floats) -> Floats:
        """(m,) posterior mean at (m, d) positions."""
        gp = self.gp
        scales = np.array([gp.standardiser.scale(world) for world in gp.worlds])
        centres = np.array([gp.standardiser.centre(world) for world in gp.worlds])
        origin = np.full((1, gp.space.dimension), 0.5)
        level = self._standardised(origin, None)[0]
        # Worlds differ by an offset and a scale: one pass over f serves all of them.
        offsets = np.array([self._standardised(origin, world)[0] - level for world in gp.worlds])
        z = self._standardised(settle(gp.space, unit), None)
        result: Floats = self.sign * (np.mean(centres + scales * offsets) + scales.mean() * z)
        return result

    def draws(self, unit: Floats, count: int, seed: int) -> Floats:
        """(count, m) joint posterior draws, up to an offset and a factor (indices do not see them)."""
        gp = self.gp
        with torch.no_grad():
            belief = gp.model.posterior(gp.inputs(settle(gp.space, unit))).distribution
            mean, covariance = belief.mean.numpy(), belief.covariance_matrix.numpy()
        rng = np.random.default_rng(seed)
        root = np.linalg.cholesky(covariance + 1e-6 * covariance.diagonal().mean() * np.eye(len(mean)))
        result: Floats = self.sign * (mean + rng.standard_normal((count, len(mean))) @ root.T)
        return result

    def _standardised(self, unit: Floats, world: World | None) -> Floats:
        """Posterior mean without the covariance between test points: k(x, X) (K + noise)^-1 (y - m)."""
        model = self.gp.model
        with torch.no_grad(), gpytorch.settings.fast_pred_var(False):
            train = model.train_inputs[0]
            noisy = model.covar_module(train).to_dense() + model.likelihood.noise * torch.eye(
                len(train), dtype=train.dtype
            )
            constant = model.mean_module(train[:1])
            weights = torch.linalg.solve(noisy, model.train_targets - constant)
            parts = [
                constant + model.covar_module(self.gp.inputs(block, world), train).to_dense() @ weights
                for block in np.array_split(unit, max(1, math.ceil(len(unit) / _CHUNK)))
            ]
            return torch.cat(parts).numpy()


def settle(space: SearchSpace, unit: Floats) -> Floats:
    """(m, d) positions with integers and choices at the values they stand for."""
    out = np.array(unit, dtype=float)
    for i in space.discrete_dimensions:
        parameter = space.parameters[i]
        out[:, i] = [parameter.to_unit(parameter.from_unit(u)) for u in out[:, i]]
    return out


@dataclass(frozen=True)
class Importance:
    """One parameter's shares of the variance over the search space, with 95 % intervals.

    ``sampling`` intervals cover the finite Monte Carlo sample only; ``belief`` intervals also what the missions
    leave open about the function (posterior draws; kernel parameters fixed).
    """

    path: str
    first: float
    total: float
    first_sampling: tuple[float, float]
    total_sampling: tuple[float, float]
    first_belief: tuple[float, float]
    total_belief: tuple[float, float]
    fanova: float | None  # Optuna's, from the missions without our surrogate; sum to 1
    ped_anova: float | None  # what tells the best tenth from the rest; sum to 1


@dataclass(frozen=True)
class Interaction:
    """Two parameters together: their interaction's share, and the surrogate averaged over all others."""

    paths: tuple[str, str]
    second: float
    second_sampling: tuple[float, float]
    second_belief: tuple[float, float]
    axes: tuple[list[Any], list[Any]]  # parameter values at the map's cells
    mean: Floats  # (g, g) objective; [i, j] at axes[0][i], axes[1][j]


@dataclass(frozen=True)
class Sensitivity:
    """The finished analysis."""

    data: MissionData
    importances: list[Importance]  # most important (total) first
    interaction: Interaction | None  # None with a single parameter
    explained: float  # leave-one-out share of the standardised outcomes' variance that the GP explains
    signal_sd: float  # of the posterior mean over the search space, objective's unit
    noise_sd: float  # of a single mission, as the surrogate sees it, objective's unit

    @property
    def caution(self) -> str:
        """Why not to believe the indices; empty if there is no such reason."""
        if not math.isfinite(self.importances[0].total):
            return "the surrogate is flat: the missions show no effect of any parameter"
        if self.explained < 0.1:
            return (
                f"the surrogate explains {100 * max(0.0, self.explained):.0f} % of the missions' variance "
                "(leave-one-out): the indices describe a guess, not the objective"
            )
        return ""

    def to_dict(self) -> dict[str, Any]:
        """JSON form."""
        tree: dict[str, Any] = {
            "metric": self.data.objective.metric,
            "search_space": self.data.space.name,
            "missions": len(self.data.observations),
            "rocks": list(self.data.rocks),
            "left_out": self.data.left_out,
            "explained_leave_one_out": self.explained,
            "signal_sd": self.signal_sd,
            "noise_sd": self.noise_sd,
            "caution": self.caution,
            "parameters": [vars(item) for item in self.importances],
        }
        if self.interaction is not None:
            tree["interaction"] = {**vars(self.interaction), "mean": self.interaction.mean.tolist()}
        return tree


def sensitivity(data: MissionData, seed: int = 0) -> Sensitivity:
    """Fit the campaign's surrogate to the missions and take it apart.

    Raises
    ------
    UserError
        Too few missions to fit anything.
    """
    space, d = data.space, data.space.dimension
    if len(data.observations) < 2 * (d + 1):
        raise UserError(
            f"{len(data.observations)} missions for {d} parameters; fly at least {2 * (d + 1)} before asking what matters"
        )
    worlds = tuple(dict.fromkeys(o.world for o in data.observations))
    gp = RockMeanGP(space, data.observations, worlds, seed)
    surrogate = Surrogate(gp, data.objective.sign)
    with numerics(seed):
        pair = _pair(space, surrogate, seed)
        pairs = [] if pair is None else [pair]
        design = sobol_design(d, MEAN_SAMPLES, seed, pairs)
        values = surrogate.mean(design.points)
        point = sobol_indices(design, values)
        sampling = bootstrap_interval(design, values, seed, RESAMPLES)
        small = sobol_design(d, DRAW_SAMPLES, seed, pairs)
        belief = bootstrap_interval(small, surrogate.draws(small.points, DRAWS, seed), seed, RESAMPLES)
        loo = gp.leave_one_out()
    fanova, ped_anova = optuna_importances(data, seed)
    importances = [
        Importance(
            path,
            float(point.first[i]),
            float(point.total[i]),
            _at(sampling, "first", i),
            _at(sampling, "total", i),
            _at(belief, "first", i),
            _at(belief, "total", i),
            fanova.get(path),
            ped_anova.get(path),
        )
        for i, path in enumerate(space.paths)
    ]
    interaction = None
    if pair is not None:
        grid = main_effect_map(surrogate.mean, d, pair, MAP_GRID, MAP_SAMPLES, seed)
        centres = (np.arange(MAP_GRID) + 0.5) / MAP_GRID
        first, second = (space.parameters[i] for i in pair)
        interaction = Interaction(
            (first.path, second.path),
            float(point.second[0]),
            _at(sampling, "second", 0),
            _at(belief, "second", 0),
            ([first.from_unit(u) for u in centres], [second.from_unit(u) for u in centres]),
            grid,
        )
    spread = float(np.var(loo.observed))
    return Sensitivity(
        data,
        sorted(importances, key=lambda item: -item.total if math.isfinite(item.total) else 0.0),
        interaction,
        1.0 - loo.rmse**2 / spread if spread > 0 else 0.0,
        math.sqrt(max(0.0, float(point.variance))),
        gp.noise_sd,
    )


def _pair(space: SearchSpace, surrogate: Surrogate, seed: int) -> Pair | None:
    """The gate's two thresholds where both are tuned, else the two parameters of largest total index."""
    if space.dimension < 2:
        return None
    if all(path in space.paths for path in GATE_PAIR):
        return space.paths.index(GATE_PAIR[0]), space.paths.index(GATE_PAIR[1])
    design = sobol_design(space.dimension, MEAN_SAMPLES, seed)
    total = np.nan_to_num(sobol_indices(design, surrogate.mean(design.points)).total)
    i, j = sorted(int(k) for k in np.argsort(-total, kind="stable")[:2])
    return i, j


def _at(bounds: tuple[SobolIndices, SobolIndices], name: str, index: int) -> tuple[float, float]:
    low, high = (getattr(bound, name)[index] for bound in bounds)
    return float(low), float(high)


def optuna_importances(data: MissionData, seed: int) -> tuple[dict[str, float], dict[str, float]]:
    """fANOVA (Hutter et al., ICML 2014) and PED-ANOVA (Watanabe et al., IJCAI 2023) of the missions themselves.

    Outcomes are standardised per rock and condition first, or hard rocks would look like bad configurations. Empty where
    Optuna finds nothing to attribute (no spread, too few missions).
    """
    worlds = [o.world for o in data.observations]
    outcomes = np.array([o.outcome for o in data.observations], dtype=float)
    targets = RockStandardiser.fit(worlds, outcomes).standardise(worlds, outcomes)
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    study = optuna.create_study(direction="maximize")
    known = distributions(data.space)
    study.add_trials(
        [
            optuna.trial.create_trial(params=dict(o.values), distributions=known, value=float(z))
            for o, z in zip(data.observations, targets)
        ]
    )
    evaluators: list[Callable[[], Any]] = [
        lambda: FanovaImportanceEvaluator(seed=seed),
        PedAnovaImportanceEvaluator,
    ]
    found = []
    for evaluator in evaluators:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            try:
                shares = get_param_importances(study, evaluator=evaluator())
            except (ValueError, RuntimeError):  # Optuna refuses data without spread
                shares = {}
        found.append({path: float(share) for path, share in shares.items() if math.isfinite(share)})
    return found[0], found[1]
