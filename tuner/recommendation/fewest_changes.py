"""Of configurations flown, the one to use: the fewest changes that are not worse than the best.

Most of what a search moves makes no difference: its values are where the search happened to be. So among those that are
better than the default, with a calibrated 95 % interval, the one with the fewest changes is taken that is not worse than the
best (`no_loss`). Where none is, the default is: its gain is inside the noise.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from tuner.surrogate.forward_check import Calibration
from tuner.surrogate.posterior import Posterior

EXPECTED_LOSS = 0.25  # of the noise of a mission
RISK_OF_LOSS = 0.05


def no_loss(belief: Posterior, i: int, best: int, calibrated: Calibration, noise_sd: float) -> bool:
    """Return whether entry ``i`` loses nothing against entry ``best``.

    The posterior mean of the difference is no loss above `EXPECTED_LOSS` of a mission's noise, and a loss above the noise of
    one mission has a probability of at most `RISK_OF_LOSS`.

    Parameters
    ----------
    belief
        The joint posterior of all entries.
    i, best
        Their indices in ``belief``.
    calibrated
        The calibration of its intervals.
    noise_sd
        The standard deviation of one mission, objective's unit.
    """
    mean, sd = belief.difference(i, best)
    unlikely = calibrated.probability_positive(mean + noise_sd, sd) >= 1.0 - RISK_OF_LOSS
    return mean >= -EXPECTED_LOSS * noise_sd and (unlikely or sd <= 1e-12)


def stated_loss(belief: Posterior, i: int, best: int, calibrated: Calibration) -> bool:
    """Return whether the calibrated 95 % interval of the difference says that entry ``i`` is worse than ``best``.

    Parameters
    ----------
    belief
        The joint posterior of all entries.
    i, best
        Their indices in ``belief``.
    calibrated
        The calibration of its intervals.
    """
    return calibrated.interval_95(*belief.difference(i, best))[1] < 0.0


def fewest_changes(
    configurations: Sequence[Mapping[str, Any]],
    among: Sequence[int],
    default: Mapping[str, Any],
    belief: Posterior,
    calibrated: Calibration,
    noise_sd: float,
) -> int:
    """Return the index of the configuration to use, as above.

    Parameters
    ----------
    configurations
        All configurations flown.
    among
        Indices of those that may be taken; not empty. The default is taken only where it is among them.
    default
        The default values.
    belief
        The joint posterior of ``configurations``, in their order, and of the default behind them.
    calibrated
        The calibration of its intervals.
    noise_sd
        The standard deviation of one mission, objective's unit.
    """
    reference = len(configurations)
    own = [i for i in among if configurations[i] == default]
    better = list(among)
    if own:
        better = [i for i in among if calibrated.interval_95(*belief.difference(i, reference))[0] > 0.0]
        if not better:
            return own[0]
    best = max(better, key=lambda i: belief.mean[i])
    allowed = [
        i
        for i in better
        if i == best
        or (no_loss(belief, i, best, calibrated, noise_sd) and not stated_loss(belief, i, best, calibrated))
    ]
    return min(allowed, key=lambda i: (_changes(configurations[i], default), -belief.mean[i]))


def _changes(values: Mapping[str, Any], default: Mapping[str, Any]) -> int:
    return sum(value != default[path] for path, value in values.items())
