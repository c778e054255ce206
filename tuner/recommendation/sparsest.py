"""The sparsest configuration that is not worse than the recommended one.

Most of what a search moves makes no difference: its values are where the search happened to be. Parameters therefore go
back to the default values one after the other, that which costs least first, as long as the joint posterior of the result
and of the recommendation, over the training worlds and calibrated, says that nothing is lost:

- the posterior mean of the difference is no loss above `EXPECTED_LOSS` of a mission's noise (its standard deviation), and
- that more than the noise of a mission is lost has a probability of at most `RISK_OF_LOSS`.

Always against the recommendation itself, so that small losses do not add up unseen. The surrogate has the sparse prior of
the length scales here, which expects most parameters to be without effect: with the other one, 48 missions in which one
parameter of six mattered kept three to five, and nothing went back where none did.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from tuner.acquisition.within import Within
from tuner.problem.options import Risk
from tuner.problem.search_space import Values
from tuner.recommendation.recommendation import Sparsest
from tuner.surrogate.forward_check import Calibration
from tuner.surrogate.model import RockMeanGP

EXPECTED_LOSS = 0.25  # of the noise of a mission
RISK_OF_LOSS = 0.05


def sparsest(
    model: RockMeanGP,
    best: Mapping[str, Any],
    default: Mapping[str, Any],
    calibrated: Calibration,
    sign: float = 1.0,
    risk: Risk = "mean",
    within: Within | None = None,
    doubter: RockMeanGP | None = None,
) -> Sparsest:
    """Take parameters of ``best`` back to ``default``, by the criterion above.

    Parameters
    ----------
    model
        A surrogate with the sparse prior, oriented so that larger is better.
    sign
        Of the objective: +1 where larger is better. For ``mean`` alone.
    within
        A limit that the result has to keep, too.
    doubter
        The surrogate that made the recommendation: what it holds to be a loss, with its 95 % interval, is none to give up.
    """
    space, margin = model.space, model.noise_sd
    current: Values = dict(best)
    while True:
        moved = [path for path in space.paths if current[path] != default[path]]
        steps = [{**current, path: default[path]} for path in moved]
        belief = model.posterior([best, *steps], risk)
        doubts = None if doubter is None else doubter.posterior([best, *steps], risk)
        keeps = [True] * len(steps) if within is None else within.keeps(steps)
        allowed = []
        for i in range(1, len(steps) + 1):
            mean, sd = belief.difference(i, 0)
            unlikely = calibrated.probability_positive(mean + margin, sd) >= 1.0 - RISK_OF_LOSS
            if doubts is not None and calibrated.interval_95(*doubts.difference(i, 0))[1] < 0.0:
                continue
            if keeps[i - 1] and mean >= -EXPECTED_LOSS * margin and (unlikely or sd <= 1e-12):
                allowed.append((mean, i))
        if not allowed:
            break
        current = steps[max(allowed)[1] - 1]
    belief = model.posterior([best, current, default], risk)
    loss, loss_sd = belief.difference(1, 0)
    gain, gain_sd = belief.difference(1, 2)
    return Sparsest(
        values=current,
        kept=tuple(path for path in space.paths if current[path] != default[path]),
        mean=sign * float(belief.mean[1]),
        difference=loss,
        difference_interval_95=calibrated.interval_95(loss, loss_sd),
        improvement=gain,
        improvement_interval_95=calibrated.interval_95(gain, gain_sd),
        margin=margin,
    )
