"""An estimate of a share of rocks, as if so many rocks had been run and so many of them had succeeded.

The estimate is the Beta distribution of a share after those rocks, with Jeffreys' prior (Brown, Cai and DasGupta, "Interval
estimation for a binomial proportion", 2001). A Gaussian process has rocks of its own at every configuration: the variance
of one mission over that of the mean is the number of missions that would tell as much.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from scipy import special

SURE = 0.8  # probability from which on a configuration is taken to meet a constraint
_PRIOR = 0.5  # Jeffreys': half a success, half a failure


@dataclass(frozen=True)
class ShareEstimate:
    share: float  # of the rocks, 0 to 1
    rocks: float  # that would tell as much; need not be whole

    @property
    def _ab(self) -> tuple[float, float]:
        return self.share * self.rocks + _PRIOR, (1.0 - self.share) * self.rocks + _PRIOR

    @property
    def sd(self) -> float:
        a, b = self._ab
        return math.sqrt(a * b / ((a + b) ** 2 * (a + b + 1.0)))

    @property
    def interval_95(self) -> tuple[float, float]:
        """Central 95 % interval; up to 1 where no rock failed, down to 0 where none succeeded."""
        a, b = self._ab
        low = 0.0 if self.share <= 0.0 else float(special.betaincinv(a, b, 0.025))
        high = 1.0 if self.share >= 1.0 else float(special.betaincinv(a, b, 0.975))
        return low, high

    def probability(self, least: float) -> float:
        """Return the probability that the share is at least ``least``."""
        return float(special.betaincc(*self._ab, least))

    def predictive_interval(self) -> tuple[int, int]:
        """95 % interval of how many of the next hundred rocks succeed: beta-binomial."""
        from scipy.stats import betabinom  # noqa: PLC0415  a second to load

        low, high = betabinom(100, *self._ab).ppf([0.025, 0.975])
        return int(low), int(high)


def rocks_that_show(share: float) -> int:
    """Return how many rocks must succeed, and none fail, before so large a share is shown to."""
    return next(n for n in range(1, 1_000_000) if ShareEstimate(1.0, n).probability(share) >= SURE)
