"""Means over rocks with their 95 % intervals, which say what they generalise to."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy

from nbv.types import Floats

# With fewer rocks a t-interval over rocks says little but "unknown".
MIN_ROCKS = 3
CONFIDENCE = 0.95
BOOTSTRAP, LEAST_DRAWN = 1000, 5  # draws; fewer targets have no interval


@dataclass(frozen=True)
class Interval:
    """A mean in which every rock counts the same, and its 95 % confidence interval.

    ``method`` is ``rocks`` (t-interval over rock means: generalises to unseen rocks of the same kind),
    ``replicates`` (rocks taken as fixed, pooled variance between replicates: generalises to new replicates on
    these rocks only), ``bootstrap`` (over rocks), ``wilson`` (of a share of rocks), or ``none`` (too few missions for any; the
    bounds are None).
    """

    mean: float
    low: float | None
    high: float | None
    rocks: int
    missions: int
    method: str

    @property
    def reversed(self) -> Interval:
        low, high = (None if bound is None else -bound for bound in (self.high, self.low))
        return replace(self, mean=-self.mean, low=low, high=high)


def mean_interval(by_rock: Mapping[str, Sequence[float]]) -> Interval | None:
    """Mean over rocks of the mean over replicates; None without any value.

    From `MIN_ROCKS` rocks on the interval is over rocks, with fewer over replicates.
    """
    groups = [np.asarray(values, dtype=float) for values in by_rock.values() if len(values)]
    if not groups:
        return None
    rocks, missions = len(groups), int(sum(len(g) for g in groups))
    means = np.array([g.mean() for g in groups])
    mean = float(means.mean())
    if rocks >= MIN_ROCKS:
        method, degrees = "rocks", rocks - 1
        error = float(means.std(ddof=1)) / math.sqrt(rocks)
    elif missions > rocks:
        method, degrees = "replicates", missions - rocks
        pooled = sum(float(((g - g.mean()) ** 2).sum()) for g in groups) / degrees
        error = math.sqrt(pooled * sum(1 / len(g) for g in groups)) / rocks
    else:
        return Interval(mean, None, None, rocks, missions, "none")
    half = float(scipy.special.stdtrit(degrees, 0.5 + CONFIDENCE / 2)) * error
    return Interval(mean, mean - half, mean + half, rocks, missions, method)


def bootstrap_bounds(statistic: Callable[..., Any], values: Any, **how: Any) -> tuple[Any, Any]:
    """95 % bootstrap interval of a statistic over rocks, the last axis of ``values`` (..., R); None, None for too few."""
    if values.shape[-1] < LEAST_DRAWN:
        return None, None
    same_draws = {"n_resamples": BOOTSTRAP, "rng": np.random.default_rng(0)}
    result = scipy.stats.bootstrap((values,), statistic, axis=-1, method="percentile", **same_draws, **how)
    return result.confidence_interval.low, result.confidence_interval.high


def bootstrapped(mean: float, low: float | None, high: float | None, rocks: int) -> Interval:
    return Interval(mean, low, high, rocks, rocks, "none" if low is None else "bootstrap")


def bootstrap_means(values: Floats) -> list[Interval]:
    """Mean over rocks of each row of (K, R) values, or of one row (R,), with its bootstrap interval."""
    values = np.atleast_2d(values)
    low, high = bootstrap_bounds(np.mean, values)
    bounds = [(None, None)] * len(values) if low is None else zip(low.tolist(), high.tolist())
    return [bootstrapped(float(row.mean()), *pair, len(row)) for row, pair in zip(values, bounds)]
