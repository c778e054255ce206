"""Outcomes made comparable over rocks."""

from __future__ import annotations

import math
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from nbv.types import Floats

# Pseudo-counts of the shrinkage below: a rock's own spread counts fully only beyond this many missions.
_SCALE_PRIOR_COUNT = 5.0
FAR = 2.0  # ranges of all others: no outcome counts as further from them
FEW = 20  # one outcome in so many may be an outlier
_SMALLEST = 1e-6  # spread within rocks, of the range of all outcomes
_ROUNDING = 1e-14  # of a number
_SAME = 1e-9  # of an outcome: the same photographs in another order differ by less


@dataclass(frozen=True)
class RockStandardiser:
    """Standardisation by rock that stays sane with one or two missions on a rock.

    z = (y - centre[rock]) / scale[rock]. Centres are empirical-Bayes estimates of a random rock effect:
    y = mu + a_rock + e, with the variances of a and e estimated from the data, so that a rock's centre moves
    from the grand mean towards its own mean as the rock effect stands out from the spread within rocks.
    Scales are within-rock standard deviations shrunk towards the pooled one by 5 pseudo-observations.
    Rocks never run get the grand mean and the pooled scale.
    """

    centres: Mapping[Any, float]
    scales: Mapping[Any, float]
    grand_mean: float
    pooled_scale: float

    @staticmethod
    def fit(
        rocks: Sequence[Any],
        outcomes: Floats | Sequence[float],
        *,
        shrink_centres: bool = True,
        blocks: Sequence[Hashable] | None = None,
    ) -> RockStandardiser:
        """Return the standardiser estimated from n outcomes; n may be 0.

        ``shrink_centres``: without it each rock is centred on its own mean: for a model that infers what is left of
        the rock effect by itself. ``blocks``: (n,) blocks, each within one rock: scales are then standard deviations
        within blocks, for a model that infers what is common to a block.
        """
        y = np.asarray(outcomes, dtype=float)
        if len(y) == 0:
            return RockStandardiser({}, {}, 0.0, 1.0)
        inside = {name: np.array([rock == name for rock in rocks]) for name in sorted(set(rocks))}
        means = {name: float(y[rows].mean()) for name, rows in inside.items()}
        counts = {name: int(rows.sum()) for name, rows in inside.items()}
        residual, shares = _residuals(y, rocks if blocks is None else blocks)
        squares = {name: float((residual[rows] ** 2).sum()) for name, rows in inside.items()}
        freedom = {name: float(shares[rows].sum()) for name, rows in inside.items()}
        degrees = sum(freedom.values())
        between = float(np.var(list(means.values()), ddof=1)) if len(means) > 1 else 0.0
        # With one mission per rock nothing tells rock from configuration: share the spread between them.
        within = sum(squares.values()) / degrees if degrees > 0.5 else between / 2 if len(means) > 1 else 1.0
        within = max(within, (_SMALLEST * float(np.ptp(y))) ** 2, (_ROUNDING * float(np.abs(y).max())) ** 2)
        within = within or 1.0  # all are 0
        mean_inverse_count = float(np.mean([1 / count for count in counts.values()]))
        rock_variance = max(0.0, between - within * mean_inverse_count)

        precision = {name: 1 / (rock_variance + within / count) for name, count in counts.items()}
        grand = sum(precision[name] * means[name] for name in means) / sum(precision.values())
        centres, scales = {}, {}
        for name, count in counts.items():
            weight = rock_variance / (rock_variance + within / count) if shrink_centres else 1.0
            centres[name] = grand + weight * (means[name] - grand)
            prior = _SCALE_PRIOR_COUNT
            scales[name] = math.sqrt((prior * within + squares[name]) / (prior + freedom[name]))
        return RockStandardiser(centres, scales, grand, math.sqrt(within))

    def standardise(self, rocks: Sequence[Any], outcomes: Floats | Sequence[float]) -> Floats:
        """Return (n,) standardised outcomes."""
        return np.array([(y - self.centre(rock)) / self.scale(rock) for rock, y in zip(rocks, outcomes)])

    def centre(self, rock: Any) -> float:
        """Return the rock's centre, in the outcome's unit."""
        return self.centres.get(rock, self.grand_mean)

    def scale(self, rock: Any) -> float:
        """Return the rock's scale, in the outcome's unit."""
        return self.scales.get(rock, self.pooled_scale)


def winsorised(groups: Sequence[Hashable], outcomes: Floats | Sequence[float]) -> Floats:
    """Return (n,) outcomes, those far from all others moved to `FAR` ranges of the others: winsorised.

    The middle half of the deviations from the groups' medians is accepted, and step by step the next one on either side, where
    its distance is at most `FAR` ranges of what is accepted already. Where more lie beyond than one in `FEW`, they are accepted
    on the good side, and on the bad one up to a distance that grows with the square of their number.
    """
    y = np.asarray(outcomes, dtype=float)
    if len(y) == 0:
        return y
    centre = _middles(groups, y)
    deviation = y - centre
    v, n = np.sort(deviation), len(y)
    some = v[np.diff(v, prepend=-np.inf) > _SAME * float(np.abs(centre).max())]
    if len(some) == 3 and n >= FEW // 2:  # a quarter of three is none: all but the farthest from the middle
        some = some[1:] if some[1] - some[0] > some[2] - some[1] else some[:-1]
    low, high = some[len(some) // 4], some[-1 - len(some) // 4]
    least = _ROUNDING * float(np.abs(centre).max())
    while True:
        width, before = max(high - low, least), (low, high)
        below, above = np.searchsorted(v, low), n - np.searchsorted(v, high, "right")
        if below and low - v[below - 1] <= FAR * width * max(1.0, (FEW * below / n) ** 2):
            low = v[below - 1]
        if above and (above > max(1, n // FEW) or v[n - above] - high <= FAR * width):
            high = v[n - above]
        if (low, high) == before:
            taken = np.clip(deviation, low - FAR * width, high + FAR * width)
            return np.where(taken == deviation, y, centre + taken)


def _middles(groups: Sequence[Hashable], y: Floats) -> Floats:
    """Return (n,) medians of the groups; of the two in the middle of a group the one nearer to all outcomes' median."""
    overall, middle = np.median(y), np.empty(len(y))
    for group in set(groups):
        inside = np.array([g == group for g in groups])
        ys = np.sort(y[inside])
        middle[inside] = min(ys[(len(ys) - 1) // 2], ys[len(ys) // 2], key=lambda m: abs(m - overall))
    return middle


def _residuals(y: Floats, groups: Sequence[Hashable]) -> tuple[Floats, Floats]:
    """Return (n,) deviations from the group means, and (n,) shares of the degrees of freedom, 1 - 1 / group size."""
    residual, share = np.empty(len(y)), np.empty(len(y))
    for group in set(groups):
        inside = np.array([g == group for g in groups])
        residual[inside] = y[inside] - y[inside].mean()
        share[inside] = 1 - 1 / inside.sum()
    return residual, share
