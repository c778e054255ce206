"""How the recommended configuration keeps a limit, on the training rocks and on the next one."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy import special

from tuner.acquisition.constrained import Constraint
from tuner.problem.instances import are_drawn, rocks_of
from tuner.problem.objective import Objective
from tuner.problem.share import ShareBelief
from tuner.recommendation.next_rock import PRIOR_ROCKS
from tuner.recommendation.recommendation import Limit
from tuner.surrogate.model import RockMeanGP
from tuner.surrogate.posterior import DeterministicOutcome, interval_95


def limit_of(
    constraint: Constraint,
    second: Objective,
    limit: float,
    values: Mapping[str, Any],
    default: Mapping[str, Any],
    kept: bool,
    own: Sequence[float | None] | None,
    no_worse: float | None,
) -> Limit:
    """Return how the recommended configuration keeps the limit on the training instances, and on the next rock.

    Parameters
    ----------
    constraint
        The limit and the model of what has it.
    second
        The second objective.
    limit
        Its limit, in the metric's unit.
    values, default
        The recommended and the default values.
    kept
        Whether any configuration run can be taken to keep the limit.
    own
        What the missions that ran the recommended values had of it, where one failed None; None: say nothing of rocks
        never run.
    no_worse
        Probability that the values are no worse than the default on the next rock, where it is known.
    """
    belief, sign = constraint.model.posterior([values, default]), second.sign
    probability, of_default = constraint.probability([values, default])
    mean, default_mean, sd = sign * float(belief.mean[0]), sign * float(belief.mean[1]), float(belief.sd[0])
    interval, next_rocks, evaluated = interval_95(mean, sd), None, None
    if constraint.is_share:
        next_rocks, default_mean = (
            constraint.shares([values])[0],
            constraint.shares([default])[0].share * 100.0,
        )
        low, high = next_rocks.interval_95
        mean, sd, interval = 100.0 * next_rocks.share, 100.0 * next_rocks.sd, (100.0 * low, 100.0 * high)
        measured = [y for y in own or () if y is not None]
        evaluated = (sum(y > 0.0 for y in measured), len(measured))
    elif own is not None:
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


def _next_rocks(constraint: Constraint, values: Mapping[str, Any]) -> ShareBelief:
    """Return the belief about the share of rocks never run on which ``values`` keep the limit of a mean."""
    model = constraint.model
    assert isinstance(model, RockMeanGP)
    rocks = rocks_of(model.instances)
    if not are_drawn(rocks):  # as if so many of the training rocks kept it
        return ShareBelief(_next_rock_keeps(model, values, constraint.at_least), len(rocks))
    belief, one = model.posterior([values]), model.one_mission_sd  # every block is a rock
    evaluated = (one / max(float(belief.sd[0]), 1e-9 * one)) ** 2
    z = (float(belief.mean[0]) - constraint.at_least) / math.hypot(one, float(belief.sd[0]))
    return ShareBelief(float(special.stdtr(PRIOR_ROCKS + evaluated, z)), evaluated)


def _next_rock_keeps(model: RockMeanGP, values: Mapping[str, Any], at_least: float) -> float:
    """Return the probability that the mean of ``values`` on a rock never run is ``at_least`` that; larger is better.

    The next rock is drawn like the training rocks: Student's t, whose spread has a prior worth `PRIOR_ROCKS` rocks that
    differ as much as missions on one rock do.
    """
    belief = model.posterior([values])
    rocks = rocks_of(model.instances)
    own = [
        np.mean([model.predict_mission(values, w)[0] for w in model.instances if w.rock == rock])
        for rock in rocks
    ]
    freedom = PRIOR_ROCKS + len(rocks) - 1
    between = (
        PRIOR_ROCKS * (model.noise_sd**2 + (model.block_sd or 0.0) ** 2) + float(np.var(own)) * len(rocks)
    ) / freedom
    sd = math.sqrt(between * (1 + 1 / len(rocks)) + float(belief.sd[0]) ** 2)
    return float(special.stdtr(freedom, (float(belief.mean[0]) - at_least) / sd))
