"""Whether the recommended configuration meets the outcome constraint, on the training rocks and on the next one."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy import special

from tuner.acquisition.constrained import Constraint
from tuner.problem.goal import Goal
from tuner.problem.instances import are_drawn, rocks_of
from tuner.problem.observations import Observation
from tuner.problem.problem import Problem
from tuner.problem.share import ShareEstimate
from tuner.recommendation.next_rock import PRIOR_ROCKS
from tuner.recommendation.recommendation import Limit
from tuner.surrogate.model import InstanceMeanGP
from tuner.surrogate.posterior import DeterministicOutcome, interval_95


def limit_of(
    problem: Problem,
    goal: Goal,
    constraint: Constraint | None,
    values: Mapping[str, Any],
    missions: Sequence[Observation],
    *,
    kept: bool,
    no_worse: float | None,
) -> Limit | None:
    """Return how the recommended ``values`` meet the constraint on the training instances and on the next rock.

    ``no_worse``: probability that the values are no worse than the default on the next rock, where it is known.

    It is None where nothing has a limit. Of the next rock nothing is said where one rock alone was run.
    """
    second, limit = goal.second, goal.limit
    if constraint is None or second is None or limit is None:
        return None
    several = len(problem.rocks) > 1 or problem.draws_rocks
    posterior, sign = constraint.model.posterior([values, problem.default]), second.sign
    probability, of_default = constraint.probability([values, problem.default])
    mean, default_mean = (sign * float(m) for m in posterior.mean)
    sd = float(posterior.sd[0])
    interval, next_rocks, evaluated = interval_95(mean, sd), None, None
    if constraint.is_share:
        next_rocks = constraint.shares([values])[0]
        default_mean = constraint.shares([problem.default])[0].share * 100.0
        low, high = next_rocks.interval_95
        mean, sd, interval = 100.0 * next_rocks.share, 100.0 * next_rocks.sd, (100.0 * low, 100.0 * high)
        outcomes = [o.second if goal.exact.first is None else o.outcome for o in missions]
        measured = [y for y in outcomes if y is not None and several]
        evaluated = (sum(y > 0.0 for y in measured), len(measured))
    elif goal.exact.first is not None and several:
        next_rocks = _next_rocks(constraint, values)
    return Limit(
        metric=second.metric,
        direction=second.direction,
        limit=limit,
        kept=kept,
        exact=isinstance(constraint.model, DeterministicOutcome),
        mean=mean,
        sd=sd,
        interval_95=interval,
        probability=float(probability),
        default_probability=float(of_default),
        default_mean=default_mean,
        next_rock_keeps=None if next_rocks is None else next_rocks.share,
        next_rock_no_worse=None if next_rocks is None else no_worse,
        next_hundred=None if next_rocks is None else next_rocks.predictive_interval(),
        evaluated=evaluated,
    )


def _next_rocks(constraint: Constraint, values: Mapping[str, Any]) -> ShareEstimate:
    """Return the estimate of the share of rocks never run on which ``values`` meet the constraint of a mean."""
    model = constraint.model
    assert isinstance(model, InstanceMeanGP)
    rocks = rocks_of(model.instances)
    if not are_drawn(rocks):  # as if so many of the training rocks kept it
        return ShareEstimate(_next_rock_keeps(model, values, constraint.at_least), len(rocks))
    posterior, one = model.posterior([values]), model.one_mission_sd  # every block is a rock
    evaluated = (one / max(float(posterior.sd[0]), 1e-9 * one)) ** 2
    z = (float(posterior.mean[0]) - constraint.at_least) / math.hypot(one, float(posterior.sd[0]))
    return ShareEstimate(float(special.stdtr(PRIOR_ROCKS + evaluated, z)), evaluated)


def _next_rock_keeps(model: InstanceMeanGP, values: Mapping[str, Any], at_least: float) -> float:
    """Return the probability that the mean of ``values`` on a rock never run is ``at_least`` that; larger is better.

    The next rock is drawn like the training rocks: Student's t, whose spread has a prior worth `PRIOR_ROCKS` rocks that
    differ as much as missions on one rock do.
    """
    posterior = model.posterior([values])
    rocks = rocks_of(model.instances)
    means = [
        np.mean([model.predict_mission(values, w)[0] for w in model.instances if w.rock == rock])
        for rock in rocks
    ]
    freedom = PRIOR_ROCKS + len(rocks) - 1
    between = (
        PRIOR_ROCKS * (model.noise_sd**2 + model.block_sd**2) + float(np.var(means)) * len(rocks)
    ) / freedom
    sd = math.sqrt(between * (1 + 1 / len(rocks)) + float(posterior.sd[0]) ** 2)
    return float(special.stdtr(freedom, (float(posterior.mean[0]) - at_least) / sd))
