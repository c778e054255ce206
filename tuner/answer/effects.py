"""What the surrogate says of a tuned configuration: parameter by parameter, group by group, and of the ten best beside it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy

from nbv.types import Floats
from tuner.problem.baselines import grouped
from tuner.problem.observations import Observation, configuration_key
from tuner.problem.search_space import SEEDS, Parameter, Region, SearchSpace, Values
from tuner.surrogate.fit import interval_95, posterior_means
from tuner.surrogate.model import InstanceMeanGP

GRID = 41  # values along a parameter
SOBOL_POINTS = 512
TEN = 10


@dataclass(frozen=True)
class Effect:
    """By the surrogate, in the metric's unit: positive where it is better."""

    mean: float
    low: float
    high: float


@dataclass(frozen=True)
class ParameterRow:
    path: str
    default: Any
    tuned: Any
    # Not known to be worse: the ends of the range around the tuned value, or choices.
    as_good: tuple[Any, ...]
    earned: Effect | None  # the tuned value over the default's, all else as tuned; None where they are equal
    importance: float  # total Sobol index in the region, 0 to 1


@dataclass(frozen=True)
class ConfigurationRow:
    values: Values
    mean: float
    low: float
    high: float
    missions: int
    planned: int | None


def parameter_rows(
    model: InstanceMeanGP, region: Region, values: Values, default: Values
) -> list[ParameterRow]:
    """Return the parameters that are free in the region, the most important first."""
    space, importance = region.space, importances(model, region)
    rows = []
    for i, p in enumerate(space.parameters):
        if p.path in region.held:
            continue
        at = list(p.choices)
        if p.kind != "categorical":
            most = region.at_most.get(p.path, p.high)
            along = (p.from_unit(float(u)) for u in np.linspace(0, 1, GRID))
            at = sorted({v for v in along if v <= most} | {values[p.path]})
        variants = [space.settled({**values, p.path: v}) for v in (default[p.path], *at)]
        posterior = model.posterior([values, *variants])
        gains = [posterior.difference(k, 0) for k in range(1, len(variants) + 1)]
        mean, sd = gains[0]
        earned = None if values[p.path] == default[p.path] else Effect(-mean, *interval_95(-mean, sd))
        good = [interval_95(*gain)[1] >= 0.0 for gain in gains[1:]]
        rows.append(
            ParameterRow(
                p.path,
                default[p.path],
                values[p.path],
                _as_good(p, at, good, values[p.path]),
                earned,
                float(importance[i]),
            )
        )
    return sorted(rows, key=lambda row: -row.importance)


def _as_good(p: Parameter, at: Sequence[Any], good: Sequence[bool], tuned: Any) -> tuple[Any, ...]:
    """Return the choices that are as good, or the ends of the unbroken range around the tuned value."""
    if p.kind == "categorical":
        return tuple(v for v, keeps in zip(at, good) if keeps or v == tuned)
    low = high = at.index(tuned)
    while low > 0 and good[low - 1]:
        low -= 1
    while high < len(at) - 1 and good[high + 1]:
        high += 1
    return at[low], at[high]


def earned_by_group(
    model: InstanceMeanGP, space: SearchSpace, values: Values, default: Values
) -> dict[str, Effect]:
    """Return by group of parameters what is lost where the group alone goes back to the default."""
    groups = grouped([path for path, value in values.items() if value != default[path]])
    variants = [
        space.settled({**values, **{path: default[path] for path in paths}}) for paths in groups.values()
    ]
    posterior = model.posterior([values, *variants])
    effects = dict[str, Effect]()
    for k, group in enumerate(groups, 1):
        mean, sd = posterior.difference(0, k)
        effects[group] = Effect(mean, *interval_95(mean, sd))
    return effects


def importances(model: InstanceMeanGP, region: Region) -> Floats:
    """Return (d,) total Sobol indices of the posterior mean in the region; 0 for what is held there."""
    space = region.space
    if space.dimension == 1:
        return np.ones(1)

    def mean_at(unit: Floats) -> Floats:
        snapped = np.array([space.snap(u) for u in region.project(unit.T)])
        means: Floats = posterior_means(model.model, model.inputs(snapped)).numpy()
        return means[None]

    box = [scipy.stats.uniform(0.0, 1.0)] * space.dimension
    indices = scipy.stats.sobol_indices(func=mean_at, n=SOBOL_POINTS, dists=box, rng=np.random.default_rng(0))
    total: Floats = np.clip(np.nan_to_num(np.asarray(indices.total_order).reshape(-1)), 0.0, 1.0)
    return total


def best_configurations(
    model: InstanceMeanGP,
    region: Region,
    history: Sequence[Observation],
    photographs: int | None,
    sign: float,
) -> list[ConfigurationRow]:
    """Return the `TEN` best of what ran in the region by posterior mean, best first; ``sign`` of the objective."""
    ran = [values for values in model.configurations if region.contains(values)]
    best = [ran[i] for i in model.best_first(ran)[:TEN]]
    if not best:
        return []
    posterior = model.posterior(best)
    keys = [configuration_key(region.space, o.values) for o in history]
    rows = []
    for k, values in enumerate(best):
        mean, sd = float(posterior.mean[k]), float(posterior.sd[k])
        low, high = sorted(sign * bound for bound in interval_95(mean, sd))
        planned = photographs - values[SEEDS] if photographs and SEEDS in values else None
        missions = keys.count(configuration_key(region.space, values))
        rows.append(ConfigurationRow(values, sign * mean, low, high, missions, planned))
    return rows


def best_so_far(
    model: InstanceMeanGP, region: Region, history: Sequence[Observation]
) -> list[tuple[int, float]]:
    """Return after each mission in the region the best posterior mean, by the final surrogate, of what had run by then."""
    inside = [o for o in history if o.feasible and region.contains(o.values)]
    if not inside:
        return []
    means = posterior_means(model.model, model.inputs_at([o.values for o in inside])).numpy()
    offset = float(np.mean([model.standardiser.centre(i.rock) for i in model.instances]))
    best = np.maximum.accumulate(means) * model.mean_scale + offset
    return [(o.number, float(y)) for o, y in zip(inside, best)]


def gate_contour(
    model: InstanceMeanGP, space: SearchSpace, values: Mapping[str, Any], points: int = 25
) -> tuple[list[float], list[float], Floats]:
    """Return values of ``gate.budget_fraction`` and ``gate.d95_m``, and (len(d95), len(fraction)) posterior means there."""
    fraction, d95 = (next(p for p in space.parameters if p.path == path) for path in GATE_THRESHOLDS)
    xs = [fraction.from_unit(float(u)) for u in np.linspace(0, 1, points)]
    ys = [d95.from_unit(float(u)) for u in np.linspace(0, 1, points)]
    grid = [{**values, fraction.path: x, d95.path: y} for y in ys for x in xs]
    means = posterior_means(model.model, model.inputs_at(grid)).numpy().reshape(points, points)
    offset = float(np.mean([model.standardiser.centre(i.rock) for i in model.instances]))
    return xs, ys, means * model.mean_scale + offset


GATE_THRESHOLDS = ("gate.budget_fraction", "gate.d95_m")
