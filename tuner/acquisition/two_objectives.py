"""A model of each of two objectives, and what they say of the configurations flown."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from nbv.types import Floats
from tuner.problem.configurations import distinct_configurations
from tuner.problem.exact_costs import Exact, modelled
from tuner.problem.objective import Objective
from tuner.problem.observations import Observation
from tuner.problem.search_space import SearchSpace
from tuner.problem.worlds import Place
from tuner.surrogate.known import KnownOutcome
from tuner.surrogate.model import RockMeanGP
from tuner.surrogate.settings import SurrogateSettings

Outcome = RockMeanGP | KnownOutcome
AT_ONCE = 500  # configurations, of which nothing is asked jointly


@dataclass(frozen=True)
class FrontPoint:
    """A configuration that no other flown one beats in both objectives, by posterior means over the rocks."""

    values: dict[str, Any]
    first: float  # metrics' units, as measured
    first_sd: float
    second: float
    second_sd: float


def two_models(
    space: SearchSpace,
    observations: Sequence[Observation],
    places: Sequence[Place],
    seed: int,
    settings: SurrogateSettings | None = None,
    exact: Exact | None = None,
) -> tuple[Outcome, Outcome]:
    """Return a model of each objective, on the missions that have both outcomes or failed.

    An objective that the configuration decides is computed, but one of the two is always a surrogate: where both are decided,
    the second one. ``ValueError`` means that there are no such missions.

    Parameters
    ----------
    space
        The search space.
    observations
        Finished missions.
    places
        The training worlds.
    seed
        The seed of the fits.
    settings
        What the surrogates are made of; None: by the search space.
    exact
        What of the objectives the configuration decides.
    """
    both = [o for o in observations if o.outcome is None or o.second is not None]
    exact = exact or Exact()
    if exact.first is not None:
        second = RockMeanGP(space, modelled(both), places, seed, settings)
        return KnownOutcome(space, exact.first), second
    first = RockMeanGP(space, both, places, seed, settings)
    if exact.second is not None:
        return first, KnownOutcome(space, exact.second)
    return first, RockMeanGP(space, modelled(both), places, seed, settings)


def flown_in_both(
    models: tuple[Outcome, Outcome],
    objectives: tuple[Objective, Objective],
    space: SearchSpace,
    missions: Sequence[Observation],
) -> list[FrontPoint]:
    """Return what is believed, or known, of every configuration flown, the best in the first objective first.

    Parameters
    ----------
    models
        A model of each objective.
    objectives
        Their metrics and directions.
    space
        The search space.
    missions
        The missions that flew the configurations.
    """
    configurations = distinct_configurations(space, missions)
    signs = objectives[0].sign, objectives[1].sign
    points = []
    for begin in range(0, len(configurations), AT_ONCE):
        some = configurations[begin : begin + AT_ONCE]
        one, two = (model.posterior(some) for model in models)
        points += [
            FrontPoint(values, signs[0] * float(m), float(s), signs[1] * float(n), float(t))
            for values, m, s, n, t in zip(some, one.mean, one.sd, two.mean, two.sd)
        ]
    return sorted(points, key=lambda point: -signs[0] * point.first)


def pareto_front(points: Sequence[FrontPoint], objectives: tuple[Objective, Objective]) -> list[FrontPoint]:
    """Return the points that no other one dominates, in the same order."""
    level: Floats = np.array([[p.first, p.second] for p in points]) * [o.sign for o in objectives]
    return [p for p, own in zip(points, level) if not ((level >= own).all(1) & (level > own).any(1)).any()]
