"""How well missions were predicted before they were flown, and how much wider the intervals should have been.

Leaving one out is kind to a model: its neighbours stay. A search goes where the model hopes for something that it has
not seen, and there its intervals are too narrow wherever the landscape is rougher than where it came from. No prior
mends that for every landscape; the missions themselves tell. The next standardised residual is taken for normal with a
variance that nobody knows, whose prior is a scaled inverse chi-square one worth ``PRIOR_COUNT`` residuals of mean square
1. Given n residuals, its prediction is Student's t with ``PRIOR_COUNT`` + n degrees of freedom, its scale the root mean
square of those and the prior's (Gelman et al., Bayesian Data Analysis, 3rd ed., sections 2.6 and 3.2).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import t as student_t

from nbv.types import Floats
from tuner.problem.observations import Observation
from tuner.problem.search_space import SearchSpace
from tuner.surrogate.kernel import Feature
from tuner.surrogate.model import RockMeanGP
from tuner.surrogate.numerics import NORMAL_95
from tuner.surrogate.settings import SurrogateSettings

PRIOR_COUNT = 5.0
MOST = 24


def widening(z: Floats) -> Floats:
    """(n + 1,) factors of the standard deviations before each of (n,) standardised residuals, and after the last."""
    squares = np.concatenate([[0.0], np.cumsum(np.asarray(z, dtype=float) ** 2)])
    factors: Floats = np.sqrt((PRIOR_COUNT + squares) / (PRIOR_COUNT + np.arange(len(squares))))
    return factors


def half_widths_95(z: Floats) -> Floats:
    """(n + 1,) half-widths of 95 % predictive intervals, in standard deviations of the model.

    Before each of (n,) standardised residuals, by those before it, and after the last.
    """
    factors = widening(z)
    widths: Floats = student_t.ppf(0.975, PRIOR_COUNT + np.arange(len(factors))) * factors
    return widths


@dataclass(frozen=True)
class AheadCheck:
    """Missions as predicted by the surrogate of all missions before them."""

    z: Floats  # (n,) standardised residuals, in the order of the missions

    @property
    def coverage_95(self) -> float:
        """Share of missions inside their 95 % predictive intervals."""
        return float(np.mean(np.abs(self.z) <= NORMAL_95))

    @property
    def coverage_95_widened(self) -> float:
        """The same after widening by what was known before each mission."""
        return float(np.mean(np.abs(self.z) <= half_widths_95(self.z)[:-1]))

    @property
    def factor(self) -> float:
        """By which the standard deviations of predictions for the next missions are to be multiplied."""
        return float(widening(self.z)[-1])

    @property
    def half_width_95(self) -> float:
        """Of the 95 % interval of the next mission, in the model's standard deviations."""
        return float(half_widths_95(self.z)[-1])

    def to_dict(self) -> dict[str, float]:
        """The figures for a report."""
        return {
            "missions": len(self.z),
            "coverage_95": self.coverage_95,
            "coverage_95_widened": self.coverage_95_widened,
            "factor": self.factor,
            "half_width_95": self.half_width_95,
        }


def check_ahead(
    space: SearchSpace,
    observations: Sequence[Observation],
    rocks: Sequence[str],
    first: int,
    seed: int = 0,
    settings: SurrogateSettings | None = None,
    feature: Feature | None = None,
) -> AheadCheck | None:
    """The check of missions from the ``first``-th successful one on, ``MOST`` of them evenly spread.

    One fit per mission checked. None where there is nothing to check.
    """
    flown = [o for o in observations if o.outcome is not None]
    later = np.arange(max(first, 1), len(flown))
    if len(later) == 0:
        return None
    residuals = []
    for i in later[np.unique(np.linspace(0, len(later) - 1, min(MOST, len(later))).round().astype(int))]:
        o = flown[i]
        model = RockMeanGP(space, flown[:i], rocks, seed, settings, feature)
        if o.rock not in model.rocks:
            continue
        mean, sd = model.predict_mission(o.values, o.rock, o.replicate)
        assert o.outcome is not None
        residuals.append((o.outcome - mean) / sd)
    return AheadCheck(np.array(residuals)) if residuals else None
