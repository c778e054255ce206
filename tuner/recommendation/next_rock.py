"""What the recommendation gains on a rock that was not run.

The mean over the training rocks is known ever better; how a configuration's gain differs from rock to rock is not. Here
the surrogate has both: a common landscape, and a departure of each rock from it, exchangeable between rocks. Rocks also
differ in their scale s, by which all that configurations do there is larger or smaller: where there is little to lose there
is little to gain. A new rock has a departure and a scale of its own, so its gain s (z + d) over the default has the mean of
the common landscape and

    sd^2 = sd_common^2 + sd_between^2,    sd_between^2 = s^2 [sd_d^2 + tau^2 (z^2 + sd_z^2 + sd_d^2)]

tau is the standard deviation of log s over the training rocks, with a prior worth `PRIOR_ROCKS` rocks: a few missions do not
tell a rock's scale, and the surrogate's are drawn together. What differs between rocks is known from as many as were run: the
interval is Student's t with `PRIOR_ROCKS` degrees of freedom more than rocks less one, as in the prediction of the next
draw from a normal distribution whose variance is unknown (Gelman et al., Bayesian Data Analysis, 3rd ed., section 3.2). How often it
covers: docs/results/held_out.md.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch
from scipy import special

from tuner.problem.instances import rocks_of
from tuner.recommendation.recommendation import NextRock
from tuner.surrogate.model import InstanceMeanGP, moments
from tuner.surrogate.posterior import probability_positive

PRIOR_ROCKS = 2  # what the priors of the departures and of the scales are worth
SCALE_SPREAD = 0.5  # sd of the logarithm of rocks' scales before any is known
AGAINST = 0.8  # probability of a loss from which on a training rock disagrees


def next_rock(model: InstanceMeanGP, values: Mapping[str, Any], default: Mapping[str, Any]) -> NextRock:
    """Return the gain of ``values`` over ``default`` on a new rock; rocks have landscapes of their own in the ``model``."""
    rocks = rocks_of(model.instances)
    unit = np.array([model.space.to_unit(v) for v in (values, default)])

    def gain(x: torch.Tensor, scale: float) -> tuple[float, float]:
        with torch.no_grad():
            mean, c = moments(model.model.posterior(x))
        variance = c[0, 0] + c[1, 1] - 2 * c[0, 1]
        return scale * float(mean[0] - mean[1]), scale * math.sqrt(max(0.0, float(variance)))

    elsewhere = model.inputs(unit)
    no_other = len(model.instances) + len(model.observations)  # index of a rock like no other
    elsewhere[:, model.space.dimension] = no_other
    mean, with_departure = gain(elsewhere, model.mean_scale)
    sd = math.sqrt(with_departure**2 + _scale_variance(model, rocks) * (mean**2 + with_departure**2))
    on = {
        rock: [
            gain(model.inputs(unit, w), model.standardiser.scale(rock))
            for w in model.instances
            if w.rock == rock
        ]
        for rock in rocks
    }
    means = {rock: float(np.mean([m for m, _ in gains])) for rock, gains in on.items()}
    against = tuple(
        rock
        for rock, gains in on.items()
        if probability_positive(-means[rock], max(s for _, s in gains)) >= AGAINST
    )
    freedom = len(rocks) - 1 + PRIOR_ROCKS
    half = float(special.stdtrit(freedom, 0.975)) * sd
    return NextRock(
        gain=mean,
        interval_95=(mean - half, mean + half),
        per_rock=means,
        against=against,
        no_worse=float(special.stdtr(freedom, mean / sd)) if sd else 0.5,
    )


def _scale_variance(model: InstanceMeanGP, rocks: Sequence[str]) -> float:
    """Return tau^2 of this file's docstring."""
    logs = [math.log(model.standardiser.scale(rock)) for rock in rocks]
    squares = float(np.var(logs)) * len(logs)
    return (PRIOR_ROCKS * SCALE_SPREAD**2 + squares) / (PRIOR_ROCKS + len(logs) - 1)
