"""How the recommended configuration keeps a limit, on the training rocks and on the next one."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy import special

from tuner.acquisition.constrained import Constraint
from tuner.problem.objective import Objective
from tuner.problem.share import ShareBelief
from tuner.problem.worlds import are_drawn, rocks_of
from tuner.recommendation.next_rock import PRIOR_ROCKS
from tuner.recommendation.recommendation import Limit
from tuner.surrogate.model import RockMeanGP
from tuner.surrogate.posterior import KnownOutcome, interval_95


def limit_of(
    constraint: Constraint,
    second: Objective,
    limit: float,
    values: Mapping[str, Any],
    default: Mapping[str, Any],
    kept: bool,
    next_rocks: Mapping[str, Any],
) -> Limit:
    """Return how the recommended configuration keeps the limit on the training worlds, and on the next rock.

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
        Whether any configuration flown can be taken to keep the limit.
    next_rocks
        `on_next_rocks`, or nothing.
    """
    belief, sign = constraint.model.posterior([values, default]), second.sign
    probability, of_default = constraint.probability([values, default])
    mean, sd = sign * float(belief.mean[0]), float(belief.sd[0])
    interval = interval_95(mean, sd)
    if constraint.is_share:
        share = constraint.shares([values])[0]
        low, high = share.interval_95
        mean, sd, interval = 100.0 * share.share, 100.0 * share.sd, (100.0 * low, 100.0 * high)
    return Limit(
        metric=second.metric,
        direction=second.direction,
        limit=limit,
        kept=kept,
        exact=isinstance(constraint.model, KnownOutcome),
        mean=mean,
        sd=sd,
        interval_95=interval,
        probability=float(probability),
        default_probability=float(of_default),
        default_mean=100.0 * constraint.shares([default])[0].share
        if constraint.is_share
        else sign * float(belief.mean[1]),
        **next_rocks,
    )


def on_next_rocks(
    constraint: Constraint, values: Mapping[str, Any], own: Sequence[float | None], no_worse: float | None
) -> dict[str, Any]:
    """Return what a `Limit` says of rocks never flown, by its fields.

    Parameters
    ----------
    constraint
        The limit and the surrogate of what has it.
    values
        The recommended values.
    own
        What the missions that flew them had of it; None: failed.
    no_worse
        Probability that they are no worse than the default on the next rock, where it is known.
    """
    model, flown = constraint.model, None
    assert isinstance(model, RockMeanGP)
    if constraint.is_share:
        share = constraint.shares([values])[0]
        measured = [y for y in own if y is not None]
        flown = (sum(y > 0.0 for y in measured), len(measured))
    elif are_drawn(rocks_of(model.worlds)):  # every block is a rock
        belief, one = model.posterior([values]), model.one_mission_sd
        rocks = (one / max(float(belief.sd[0]), 1e-9)) ** 2
        z = (float(belief.mean[0]) - constraint.at_least) / math.hypot(one, float(belief.sd[0]))
        share = ShareBelief(float(special.stdtr(PRIOR_ROCKS + rocks, z)), rocks)
    else:  # as if so many of the training rocks kept it
        share = ShareBelief(next_rock_keeps(model, values, constraint.at_least), len(rocks_of(model.worlds)))
    return {
        "next_rock_keeps": share.share,
        "next_rock_no_worse": no_worse,
        "next_hundred": share.of_the_next(),
        "flown": flown,
    }


def next_rock_keeps(model: RockMeanGP, values: Mapping[str, Any], at_least: float) -> float:
    """Return the probability that the mean of ``values`` on a rock never flown is ``at_least`` that; larger is better.

    The next rock is drawn like the training rocks: Student's t, whose spread has a prior worth `PRIOR_ROCKS` rocks that
    differ as much as missions on one rock do.
    """
    belief = model.posterior([values])
    rocks = rocks_of(model.worlds)
    own = [
        np.mean([model.predict_mission(values, w)[0] for w in model.worlds if w.rock == rock])
        for rock in rocks
    ]
    freedom = PRIOR_ROCKS + len(rocks) - 1
    between = (
        PRIOR_ROCKS * (model.noise_sd**2 + (model.block_sd or 0.0) ** 2) + float(np.var(own)) * len(rocks)
    ) / freedom
    sd = math.sqrt(between * (1 + 1 / len(rocks)) + float(belief.sd[0]) ** 2)
    return float(special.stdtr(freedom, (float(belief.mean[0]) - at_least) / sd))
