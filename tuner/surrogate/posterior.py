"""What is believed of some configurations, jointly."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from nbv.types import Floats


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

    def probability_best(self, indices: Sequence[int], seed: int, samples: int = 20_000) -> Floats:
        """Return (len(indices),) probability that each is the best of them, by joint sampling."""
        pick = np.asarray(indices)
        covariance = self.covariance[np.ix_(pick, pick)]
        rng = np.random.default_rng(seed)
        draws = rng.multivariate_normal(
            self.mean[pick], covariance, samples, check_valid="ignore", method="eigh"
        )
        return np.bincount(draws.argmax(axis=1), minlength=len(pick)) / samples
