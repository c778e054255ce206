"""What is believed of some configurations, jointly, and how that is stated: by Student's t, not by the normal distribution.

A search goes where the model hopes for something that it has not seen, and its standard deviations are estimates themselves.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy import special

from nbv.types import Floats

FREEDOM = 5.0  # degrees of freedom of what is stated


def interval_95(mean: float, sd: float) -> tuple[float, float]:
    """Return the 95 % interval that is stated of a quantity with posterior ``mean`` and ``sd``, in their unit."""
    half = float(special.stdtrit(FREEDOM, 0.975)) * sd
    return mean - half, mean + half


def probability_positive(mean: float, sd: float) -> float:
    """Return the probability that is stated for the quantity being above 0; a half where the model knows it to be 0."""
    return 0.5 if sd <= 1e-12 else float(special.stdtr(FREEDOM, mean / sd))


@dataclass(frozen=True)
class Posterior:
    """Joint Gaussian belief about the mean outcome over the training rocks, without observation noise.

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
        return float(self.mean[index] - self.mean[reference]), math.sqrt(max(0.0, float(variance)))
