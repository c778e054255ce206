"""How well missions were predicted before they were flown, and how much wider the intervals should have been.

Leaving one out is kind to a model: its neighbours stay. A search goes where the model hopes for something that it has
not seen, and there its intervals are too narrow wherever the landscape is rougher than where it came from. No prior
mends that for every landscape; the missions themselves tell. The intervals of the next mission are widened by the
root mean square of the standardised residuals so far, those of ``PRIOR_COUNT`` well predicted ones included.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from nbv.types import Floats
from tuner.earlier_missions import EarlierMissions
from tuner.history import Observation
from tuner.search_space import SearchSpace
from tuner.surrogate import NORMAL_95, RockMeanGP, SurrogateSettings

PRIOR_COUNT = 5.0
MOST = 24


def widening(z: Floats) -> Floats:
    """(n + 1,) factors of the standard deviations before each of (n,) standardised residuals, and after the last."""
    squares = np.concatenate([[0.0], np.cumsum(np.asarray(z, dtype=float) ** 2)])
    factors: Floats = np.sqrt((PRIOR_COUNT + squares) / (PRIOR_COUNT + np.arange(len(squares))))
    return factors


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
        return float(np.mean(np.abs(self.z) <= NORMAL_95 * widening(self.z)[:-1]))

    @property
    def factor(self) -> float:
        """By which the standard deviations of predictions for the next missions are to be multiplied."""
        return float(widening(self.z)[-1])

    def to_dict(self) -> dict[str, float]:
        """The figures for a report."""
        return {
            "missions": len(self.z),
            "coverage_95": self.coverage_95,
            "coverage_95_widened": self.coverage_95_widened,
            "factor": self.factor,
        }


def check_ahead(
    space: SearchSpace,
    observations: Sequence[Observation],
    rocks: Sequence[str],
    first: int,
    seed: int = 0,
    settings: SurrogateSettings | None = None,
    earlier: EarlierMissions | None = None,
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
        model = RockMeanGP(space, flown[:i], rocks, seed, settings, earlier)
        if o.rock not in model.rocks:
            continue
        mean, sd = model.predict_mission(o.values, o.rock, o.replicate)
        assert o.outcome is not None
        residuals.append((o.outcome - mean) / sd)
    return AheadCheck(np.array(residuals)) if residuals else None
