"""What the recommendation gains on a rock that nobody has flown.

The mean over the training rocks is known ever better; how a configuration's gain differs from rock to rock is not. Here
the surrogate has both: a common landscape, and a departure of each rock from it, exchangeable between rocks. A new rock has a
departure of its own, so its gain over the default has the mean of the common landscape and the variances of both:

    sd^2 = sd_common^2 + sd_between^2

The second is known from as many rocks as were flown: the interval is Student's t with `PRIOR_ROCKS` degrees of freedom more
than rocks less one, as in the prediction of the next draw from a normal distribution whose variance is unknown (Gelman et al.,
Bayesian Data Analysis, 3rd ed., section 3.2).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from scipy.stats import t as student_t

from tuner.problem.worlds import rocks_of
from tuner.surrogate.forward_check import Calibration
from tuner.surrogate.model import RockMeanGP, moments

PRIOR_ROCKS = 2  # what the prior of the departures is worth
AGAINST = 0.8  # probability of a loss from which on a training rock disagrees
MOST_ROCKS = 50


@dataclass(frozen=True)
class NextRock:
    """The gain over the default on a new rock, metric's unit, positive where the recommendation is better."""

    gain: float
    interval_95: tuple[float, float]
    between_rocks_sd: float  # of the gain, from rock to rock
    per_rock: dict[str, float]  # posterior means of the gain on the training rocks
    against: tuple[str, ...]  # training rocks that the recommendation probably makes worse
    more_rocks: (
        int | None
    )  # until the mean gain over such rocks would be told from 0, if it is as believed; None: too many

    @staticmethod
    def from_dict(tree: Mapping[str, Any]) -> NextRock:
        """The inverse of ``dataclasses.asdict``, after JSON too."""
        return NextRock(
            **{**tree, "interval_95": tuple(tree["interval_95"]), "against": tuple(tree["against"])}
        )


def next_rock(
    model: RockMeanGP, values: Mapping[str, Any], default: Mapping[str, Any], calibrated: Calibration
) -> NextRock:
    """The gain of ``values`` over ``default`` on a new rock; ``model``: a surrogate with own landscapes."""
    rocks = rocks_of(model.worlds)
    unit = np.array([model.space.to_unit(v) for v in (values, default)])

    def gain(x: torch.Tensor, scale: float) -> tuple[float, float]:
        with torch.no_grad():
            mean, c = moments(model.model.posterior(x))
        variance = c[0, 0] + c[1, 1] - 2 * c[0, 1]
        return scale * float(mean[0] - mean[1]), scale * math.sqrt(max(0.0, float(variance)))

    common = model.inputs(unit)
    elsewhere = common.clone()
    elsewhere[:, model.space.dimension] = len(rocks) + len(model.observations)  # a rock like no other
    mean, sd = gain(elsewhere, model.mean_scale)
    _, common_sd = gain(common, model.mean_scale)
    between = math.sqrt(max(0.0, sd**2 - common_sd**2))
    on = {
        rock: [
            gain(model.inputs(unit, w), model.standardiser.scale(w)) for w in model.worlds if w.rock == rock
        ]
        for rock in rocks
    }
    own = {rock: float(np.mean([m for m, _ in found])) for rock, found in on.items()}
    against = tuple(
        rock
        for rock, found in on.items()
        if calibrated.probability_positive(-own[rock], max(s for _, s in found)) >= AGAINST
    )
    half = float(student_t.ppf(0.975, len(rocks) - 1 + PRIOR_ROCKS)) * sd
    return NextRock(
        gain=mean,
        interval_95=(mean - half, mean + half),
        between_rocks_sd=between,
        per_rock=own,
        against=against,
        more_rocks=_more_rocks(abs(mean), common_sd, between, len(rocks)),
    )


def _more_rocks(gain: float, common_sd: float, between: float, rocks: int) -> int | None:
    """Until the 95 % interval of the mean gain excludes 0; its variance falls with the number of rocks."""
    for count in range(rocks, MOST_ROCKS + 1):
        sd = max(common_sd * math.sqrt(rocks / count), between / math.sqrt(count))
        if float(student_t.ppf(0.975, count - 1 + PRIOR_ROCKS)) * sd < gain:
            return count - rocks
    return None
