"""Means and paired differences over rocks and replicates, with intervals that say what they generalise to."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

# With fewer rocks a t-interval over rocks says little but "unknown".
MIN_ROCKS = 3
CONFIDENCE = 0.95


@dataclass(frozen=True)
class Interval:
    """A mean in which every rock counts the same, and its 95 % confidence interval.

    ``method`` is ``rocks`` (t-interval over rock means: generalises to unseen rocks of the same kind),
    ``replicates`` (rocks taken as fixed, pooled variance between replicates: generalises to new replicates on
    these rocks only), ``wilson`` (of a share of rocks), or ``none`` (too few missions for any; the bounds are None).
    """

    mean: float
    low: float | None
    high: float | None
    rocks: int
    missions: int
    method: str

    @property
    def excludes_zero(self) -> bool:
        """Whether 0 lies outside the interval."""
        return self.low is not None and self.high is not None and (self.low > 0 or self.high < 0)


def mean_interval(by_rock: Mapping[str, Sequence[float]], least_rocks: int = MIN_ROCKS) -> Interval | None:
    """Mean over rocks of the mean over replicates; None without any value.

    From ``least_rocks`` rocks on the interval is over rocks, with fewer over replicates.
    """
    groups = [np.asarray(values, dtype=float) for values in by_rock.values() if len(values)]
    if not groups:
        return None
    rocks, missions = len(groups), int(sum(len(g) for g in groups))
    means = np.array([g.mean() for g in groups])
    mean = float(means.mean())
    if rocks >= least_rocks:
        method, degrees = "rocks", rocks - 1
        error = float(means.std(ddof=1)) / math.sqrt(rocks)
    elif missions > rocks:
        method, degrees = "replicates", missions - rocks
        pooled = sum(float(((g - g.mean()) ** 2).sum()) for g in groups) / degrees
        error = math.sqrt(pooled * sum(1 / len(g) for g in groups)) / rocks
    else:
        return Interval(mean, None, None, rocks, missions, "none")
    half = stats.t.ppf(0.5 + CONFIDENCE / 2, degrees) * error
    return Interval(mean, mean - half, mean + half, rocks, missions, method)


@dataclass(frozen=True)
class PairedDifference:
    """Strategy minus reference on the (rock, replicate) pairs that both finished."""

    interval: Interval  # of the difference, metric's unit
    pairs: int
    wins: int  # pairs on which the strategy is the better one
    losses: int

    @property
    def exactly_zero(self) -> bool:
        """Whether no pair differs at all."""
        return self.wins == self.losses == 0


def paired_difference(
    strategy: Mapping[tuple[str, int], float],
    reference: Mapping[tuple[str, int], float],
    higher_is_better: bool,
) -> PairedDifference | None:
    """Differences on common (rock, replicate) pairs; None when there are none."""
    by_rock: dict[str, list[float]] = {}
    for rock, replicate in sorted(set(strategy) & set(reference)):
        by_rock.setdefault(rock, []).append(strategy[rock, replicate] - reference[rock, replicate])
    interval = mean_interval(by_rock)
    if interval is None:
        return None
    gains = [d if higher_is_better else -d for values in by_rock.values() for d in values]
    return PairedDifference(interval, len(gains), sum(g > 0 for g in gains), sum(g < 0 for g in gains))
