"""What may be better than the recommendation: what to fly before it is believed."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from tuner.acquisition.constrained import SURE, Constraint
from tuner.problem.exact_costs import ExactCost
from tuner.problem.objective import Objective
from tuner.problem.observations import Observation
from tuner.problem.options import Risk
from tuner.problem.search_space import Values
from tuner.problem.worlds import Place
from tuner.recommendation.backward_elimination import backward_elimination
from tuner.recommendation.inactive import Inactive
from tuner.recommendation.recommendation import RunnerUp
from tuner.surrogate.forward_check import Calibration
from tuner.surrogate.kernel import Feature
from tuner.surrogate.known import KnownOutcome
from tuner.surrogate.model import RockMeanGP

POINTS = 512  # of the space, among which something cheaper is looked for


def fewer_changes(
    model: RockMeanGP,
    missions: Sequence[Observation],
    best: Values,
    inactive: Sequence[Inactive],
    default: Mapping[str, Any],
    calibrated: Calibration,
    risk: Risk,
    constraint: Constraint | None,
    feature: Feature | None,
    seed: int,
    places: Sequence[Place],
) -> Values:
    """Return ``best`` without the changes that it does not need, by a surrogate with the sparse prior.

    The missions of ``best`` would have been the same with some parameters at the default (``inactive``), so they count there.

    Parameters
    ----------
    model
        The surrogate that found ``best``.
    missions
        The missions behind it.
    best, default
        The best configuration found and the default values.
    inactive
        Parameters of ``best`` whose numbers changed no choice.
    calibrated
        The calibration of the model's intervals.
    risk
        The measure over worlds.
    constraint
        A limit that the result has to keep, too.
    feature
        A feature of the surrogate, such as the landscape of earlier missions.
    seed
        The seed of the sparse surrogate's fit.
    places
        The training worlds.
    """
    free = {found.path: default[found.path] for found in inactive if found.default_is_the_same}
    few = [
        dataclasses.replace(o, values={**o.values, **free}) if free and dict(o.values) == best else o
        for o in missions
    ]
    of_few = model
    if free or not model.settings.sparse:
        sparse = dataclasses.replace(model.settings, sparse=True)
        of_few = RockMeanGP(model.space, few, places, seed, sparse, feature)
    return backward_elimination(of_few, {**best, **free}, default, calibrated, risk, constraint, model)


def cheaper(
    model: RockMeanGP, constraint: Constraint, exact: ExactCost, values: Mapping[str, Any], seed: int
) -> list[Values]:
    """Return the cheapest configuration believed to keep the limit, flown or not, as a list of at most one.

    Parameters
    ----------
    model
        The surrogate of what has the limit.
    constraint
        That limit.
    exact
        The cost, which the configuration decides.
    values
        The recommended values; the list is empty where nothing believed to keep the limit costs less.
    seed
        The seed of the points that are looked at.
    """
    space, rng = model.space, np.random.default_rng(seed)
    unit = np.unique([space.snap(u) for u in [*model.unit, *rng.random((POINTS, space.dimension))]], axis=0)
    below = [v for v in map(space.from_unit, unit) if exact.outcome(v) > exact.outcome(values)]
    if not below:
        return []
    chance = constraint.probability(below)
    order = sorted(range(len(below)), key=lambda i: (-exact.outcome(below[i]), -chance[i]))
    return [below[i] for i in order if chance[i] >= SURE][:1]


def runner_up(
    model: RockMeanGP | KnownOutcome,
    objective: Objective,
    rival: Values,
    values: Mapping[str, Any],
    default: Mapping[str, Any],
    missions: int,
    calibrated: Calibration,
    risk: Risk,
    constraint: Constraint | None,
) -> RunnerUp:
    """Return ``rival`` compared with the recommended ``values`` and the default.

    Parameters
    ----------
    model
        The model of the objective.
    objective
        The metric and its direction.
    rival, values, default
        The configuration in question, the recommended and the default one.
    missions
        How many missions flew ``rival``.
    calibrated
        The calibration of the model's intervals.
    risk
        The measure over worlds.
    constraint
        A limit of the second objective, where there is one.
    """
    belief = model.posterior([rival, values, default], risk)
    difference, gain = belief.difference(0, 1), belief.difference(0, 2)
    return RunnerUp(
        values=rival,
        changed=tuple(path for path, value in rival.items() if value != default[path]),
        missions=missions,
        mean=objective.sign * float(belief.mean[0]),
        difference=difference[0],
        difference_interval_95=calibrated.interval_95(*difference),
        improvement=gain[0],
        improvement_interval_95=calibrated.interval_95(*gain),
        probability=None if constraint is None else float(constraint.probability([rival])[0]),
    )
