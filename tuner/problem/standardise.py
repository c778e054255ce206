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


@dataclass(frozen=True)
class RockStandardiser:
    """Standardisation by rock that stays sane with one or two missions on a rock.

    z = (y - centre[rock]) / scale[rock]. Centres are empirical-Bayes estimates of a random rock effect:
    y = mu + a_rock + e, with the variances of a and e estimated from the data, so that a rock's centre moves
    from the grand mean towards its own mean as the rock effect stands out from the spread within rocks.
    Scales are within-rock standard deviations shrunk towards the pooled one by 5 pseudo-observations.
    Rocks never flown get the grand mean and the pooled scale.
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

        Parameters
        ----------
        rocks
            (n,) rock names.
        outcomes
            (n,) outcomes, larger is better.
        shrink_centres
            Without it each rock is centred on its own mean: for a model that infers what is left of the rock effect by itself.
        blocks
            (n,) blocks, each within one rock: scales are then standard deviations within blocks, for a model that infers
            what is common to a block.
        """
        y = np.asarray(outcomes, dtype=float)
        if len(y) == 0:
            return RockStandardiser({}, {}, 0.0, 1.0)
        inside = {name: np.array([rock == name for rock in rocks]) for name in sorted(set(rocks))}
        means = {name: float(y[own].mean()) for name, own in inside.items()}
        counts = {name: int(own.sum()) for name, own in inside.items()}
        residual, shares = _residuals(y, rocks if blocks is None else blocks)
        squares = {name: float((residual[own] ** 2).sum()) for name, own in inside.items()}
        freedom = {name: float(shares[own].sum()) for name, own in inside.items()}
        degrees = sum(freedom.values())
        between = float(np.var(list(means.values()), ddof=1)) if len(means) > 1 else 0.0
        # With one mission per rock nothing tells rock from configuration: share the spread between them.
        within = sum(squares.values()) / degrees if degrees > 0.5 else between / 2 if len(means) > 1 else 1.0
        within = max(within, 1e-12 * max(1.0, float(np.mean(y**2))))
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

    def mean_over(self, rocks: Sequence[Any]) -> tuple[float, float]:
        """Return ``(offset, factor)``: the mean outcome over ``rocks`` is offset + factor * z."""
        return (
            float(np.mean([self.centre(rock) for rock in rocks])),
            float(np.mean([self.scale(rock) for rock in rocks])),
        )


def _residuals(y: Floats, groups: Sequence[Hashable]) -> tuple[Floats, Floats]:
    """Return (n,) deviations from the group means, and (n,) shares of the degrees of freedom, 1 - 1 / group size."""
    residual, share = np.empty(len(y)), np.empty(len(y))
    for group in set(groups):
        inside = np.array([g == group for g in groups])
        residual[inside] = y[inside] - y[inside].mean()
        share[inside] = 1 - 1 / inside.sum()
    return residual, share
