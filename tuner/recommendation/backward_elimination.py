"""Backward elimination finds the fewest changes that are not predicted to be worse than the best configuration found.

It looks at configurations that have never flown, so its result has to be flown before it is used (`fewest_changes` chooses
among those that have flown).

Parameters go back to the default values one after the other, that which costs least first, as long as the joint posterior of
the result and of the best, over the training worlds and calibrated, says that nothing is lost (`fewest_changes.no_loss`).

Always against the best itself, so that small losses do not add up unseen. The surrogate has the sparse prior of the length
scales here, which expects most parameters to be without effect: with the other one, 48 missions in which one parameter of six
mattered kept three to five, and nothing went back where none did.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from tuner.acquisition.constrained import Constraint
from tuner.problem.options import Risk
from tuner.problem.search_space import Values
from tuner.recommendation.fewest_changes import no_loss, stated_loss
from tuner.surrogate.forward_check import Calibration
from tuner.surrogate.model import RockMeanGP


def backward_elimination(
    model: RockMeanGP,
    best: Mapping[str, Any],
    default: Mapping[str, Any],
    calibrated: Calibration,
    risk: Risk = "mean",
    constraint: Constraint | None = None,
    search_model: RockMeanGP | None = None,
) -> Values:
    """Take parameters of ``best`` back to ``default``, by the criterion above.

    Parameters
    ----------
    model
        A surrogate with the sparse prior, oriented so that larger is better.
    constraint
        A limit that the result has to keep, too.
    search_model
        The surrogate that found the best: a change stays where its 95 % interval says that going back loses something.
    """
    space, margin = model.space, model.noise_sd
    current: Values = dict(best)
    while True:
        moved = [path for path in space.paths if current[path] != default[path]]
        steps = [{**current, path: default[path]} for path in moved]
        belief = model.posterior([best, *steps], risk)
        by_search = None if search_model is None else search_model.posterior([best, *steps], risk)
        keeps = [True] * len(steps) if constraint is None else constraint.keeps(steps)
        allowed = []
        for i in range(1, len(steps) + 1):
            if by_search is not None and stated_loss(by_search, i, 0, calibrated):
                continue
            if keeps[i - 1] and no_loss(belief, i, 0, calibrated, margin):
                allowed.append((belief.difference(i, 0)[0], i))
        if not allowed:
            return current
        current = steps[max(allowed)[1] - 1]
