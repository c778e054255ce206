"""The joint posterior of some configurations, and its intervals: by Student's t, not by the normal distribution.

The Gaussian process is over-confident: a search proposes what the model over-estimates, and its standard deviations are
estimates themselves.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy import special

from nbv.types import Floats

FREEDOM = 5.0  # degrees of freedom of intervals and probabilities
CANCELLED = 1e-13  # of variances: what is left of their difference is rounding


def interval_95(mean: float, sd: float) -> tuple[float, float]:
    """Return the 95 % interval of Student's t around ``mean``, scaled by ``sd``, with `FREEDOM` degrees of freedom."""
    half = float(special.stdtrit(FREEDOM, 0.975)) * sd
    return mean - half, mean + half


def probability_positive(mean: float, sd: float) -> float:
    """Return the probability by the same distribution that a quantity is above 0; a half where ``sd`` is 0."""
    return 0.5 if sd == 0.0 else float(special.stdtr(FREEDOM, mean / sd))


@dataclass(frozen=True)
class Posterior:
    """Joint Gaussian posterior of the mean outcome over the training rocks, without observation noise.

    In the objective's unit, oriented so that larger is better.
    """

    mean: Floats  # (m,)
    covariance: Floats  # (m, m)

    @property
    def sd(self) -> Floats:
        """(m,) standard deviations."""
        return np.sqrt(np.clip(np.diag(self.covariance), 0.0, None))

    def difference(self, index: int, reference: int) -> tuple[float, float]:
        """Return ``(mean, sd)`` of entry ``index`` minus entry ``reference``."""
        c = self.covariance
        variance = c[index, index] + c[reference, reference] - 2 * c[index, reference]
        known = variance <= CANCELLED * (c[index, index] + c[reference, reference])
        return float(self.mean[index] - self.mean[reference]), 0.0 if known else math.sqrt(variance)
