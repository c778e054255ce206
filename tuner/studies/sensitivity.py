"""Which parameters of a campaign matter: Sobol indices of its surrogate.

Sobol indices (``scipy.stats.sobol_indices``; Saltelli et al., Computer Physics Communications 181, 2010) are shares of the
variance of the posterior mean over the search space, whose parameters are taken for independent and uniform.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from rich.table import Table
from scipy.stats import qmc, sobol_indices

from nbv.errors import UserError
from nbv.types import Floats
from tuner.campaign.campaign import Campaign
from tuner.problem.objective import Objective, direction_of
from tuner.problem.observations import Observation
from tuner.problem.search_space import SearchSpace
from tuner.report.labels import format_number, metric_label, parameter_label
from tuner.report.terminal import whole_tables
from tuner.surrogate.fit import posterior_means
from tuner.surrogate.model import InstanceMeanGP
from tuner.surrogate.numerics import draws_of, numerics, seeded

MEAN_POINTS, DRAW_POINTS = 2048, 128  # per sample, of the posterior mean and of joint draws
DRAWS = 200
SEED = 0  # of the fit and of the points
DOUBTFUL = 0.1  # share of the variance explained below which indices describe a guess


@dataclass(frozen=True)
class Importance:
    """One parameter's shares of the variance over the search space."""

    path: str
    first: float  # of the parameter alone
    total: float  # with all its interactions
    first_95: tuple[float, float]  # of posterior draws: what the missions leave open, kernel parameters fixed
    total_95: tuple[float, float]


@dataclass(frozen=True)
class Sensitivity:
    """The finished analysis."""

    metric: str
    missions: int
    rocks: tuple[str, ...]
    importances: list[Importance]  # most important (total) first
    explained: float  # leave-one-out share of the standardised outcomes' variance that the surrogate explains
    signal_sd: float  # of the posterior mean over the search space, objective's unit
    noise_sd: float  # of a single mission, as the surrogate sees it, objective's unit

    @property
    def caution(self) -> str:
        """Why not to believe the indices; empty if there is no such reason."""
        if not math.isfinite(self.importances[0].total):
            return "the surrogate is flat: the missions show no effect of any parameter"
        if self.explained < DOUBTFUL:
            return "the surrogate explains hardly anything: the indices describe a guess, not the objective"
        return ""


def campaign_sensitivity(directory: Path, metric: str | None = None) -> Sensitivity:
    """Return the sensitivity of a campaign's objective, or of another ``metric`` that its missions have.

    Raises
    ------
    UserError
        No campaign, or too few missions with that metric.
    """
    campaign = Campaign.open(directory, read_only=True)
    objective = campaign.settings.objective
    if metric is not None and metric != objective.metric:
        objective = Objective(metric, direction_of(metric))
    measured = [(t, t.measured(objective)) for t in campaign.trials()]
    missions = [t.observation(objective, value) for t, value in measured if value is not None]
    return sensitivity(campaign.settings.space, missions, objective)


def sensitivity(space: SearchSpace, missions: Sequence[Observation], objective: Objective) -> Sensitivity:
    """Fit the surrogate to the missions and take it apart.

    Parameters
    ----------
    space
        The search space.
    missions
        Finished missions with an outcome.
    objective
        What the outcomes are of.

    Raises
    ------
    UserError
        Too few missions to fit anything.
    """
    d = space.dimension
    if len(missions) < 2 * (d + 1):
        raise UserError(
            f"{len(missions)} missions for {d} parameters; run at least {2 * (d + 1)} before asking what matters"
        )
    gp = InstanceMeanGP(space, missions, tuple(dict.fromkeys(o.instance for o in missions)))
    with numerics(), torch.no_grad():
        points = _points(space, MEAN_POINTS)
        mean = posterior_means(gp.model, gp.inputs(points)).numpy()
        first, total = (found[0] for found in _indices(mean[None], d))
        points = _points(space, DRAW_POINTS)
        draws = draws_of(gp.model, gp.inputs(points), DRAWS, seeded(SEED)).numpy()
        first_95, total_95 = (np.nanpercentile(found, (2.5, 97.5), axis=0).T for found in _indices(draws, d))
    importances = [
        Importance(
            path,
            float(first[i]),
            float(total[i]),
            (float(first_95[i, 0]), float(first_95[i, 1])),
            (float(total_95[i, 0]), float(total_95[i, 1])),
        )
        for i, path in enumerate(space.paths)
    ]
    spread = float(np.var(gp.targets[gp.fitted_to]))
    return Sensitivity(
        objective.metric,
        len(missions),
        tuple(dict.fromkeys(o.rock for o in missions)),
        sorted(importances, key=lambda item: -item.total if math.isfinite(item.total) else 0.0),
        1.0 - gp.leave_one_out()["rmse"] ** 2 / spread if spread > 0 else 0.0,
        float(mean.std()) * gp.mean_scale,
        gp.noise_sd,
    )


def _points(space: SearchSpace, count: int) -> Floats:
    """((2 + d) count, d) positions: samples A and B, and A with each column from B; integers and choices settle."""
    d = space.dimension
    sample = qmc.Sobol(2 * d, scramble=True, rng=SEED).random(count)
    a, b = sample[:, :d], sample[:, d:]
    points: Floats = np.concatenate([a, b, *(np.where(np.arange(d) == i, b, a) for i in range(d))])
    for i in space.discrete_dimensions:
        p = space.parameters[i]
        points[:, i] = [p.to_unit(p.from_unit(u)) for u in points[:, i]]
    return points


def _indices(values: Floats, d: int) -> tuple[Floats, Floats]:
    """(s, d) first-order and total indices of s functions from their (s, (2 + d) n) values; NaN where one is flat."""
    a, b, *crosses = np.split(values, 2 + d, axis=1)
    func = {"f_A": a, "f_B": b, "f_AB": np.array(crosses)}
    with np.errstate(invalid="ignore", divide="ignore"):
        found = sobol_indices(func=func, n=a.shape[1])  # type: ignore[arg-type]
    flat = np.ptp(values, axis=1, keepdims=True) <= 1e-7
    first, total = (np.reshape(part, (len(values), d)) for part in (found.first_order, found.total_order))
    return np.where(flat, np.nan, first), np.where(flat, np.nan, total)


# -- the report ------------------------------------------------------------------------------------------------


_COLUMNS = ("parameter", "first order", "95 %", "total", "95 %")


def sensitivity_tables(result: Sensitivity, width: int) -> Iterator[Table]:
    """For the terminal, the most important parameter first."""

    def span(bounds: tuple[float, float]) -> str:
        return f"{format_number(bounds[0], 2)} to {format_number(bounds[1], 2)}"

    rows = []
    for item in result.importances:
        first, total = format_number(item.first, 2), format_number(item.total, 2)
        name = parameter_label(item.path).name
        rows.append((name, first, span(item.first_95), total, span(item.total_95)))
    return whole_tables(_COLUMNS, rows, width, f"What matters for {metric_label(result.metric).full}")


def summary_lines(result: Sensitivity) -> list[str]:
    """What a reader needs to judge the indices."""
    unit = metric_label(result.metric).difference_unit
    lines = [
        f"{result.missions} missions on {len(result.rocks)} rocks; the surrogate explains "
        f"{100 * max(0.0, result.explained):.0f} % of their variance (leave-one-out, standardised per rock).",
        f"Over the space the surrogate's mean varies with a standard deviation of "
        f"{format_number(result.signal_sd, 2)} {unit}; a single mission's noise is "
        f"{format_number(result.noise_sd, 2)} {unit}.",
    ]
    return [*lines, f"Caution: {result.caution}."] if result.caution else lines
