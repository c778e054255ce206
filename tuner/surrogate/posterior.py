"""The joint posterior of some configurations, and its intervals: by Student's t, not by the normal distribution.

The Gaussian process is over-confident: a search proposes what the model over-estimates, and its standard deviations are
estimates themselves. A deterministic metric needs no surrogate: `DeterministicOutcome` stands where one is expected.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from scipy import special

from nbv.types import Bools, Floats
from tuner.problem.deterministic_metrics import NO_MISSION, DeterministicMetric
from tuner.problem.search_space import SearchSpace

FREEDOM = 5.0  # degrees of freedom of intervals and probabilities
ROUNDING = 1e-9
CANCELLED = 1e-13  # of variances: what is left of their difference is rounding
MOST_ENDS = 256
MOST_BETWEEN = 200


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


class DeterministicOutcome:
    """A deterministic metric as a posterior without variance, oriented so that larger is better; the same on every rock."""

    def __init__(self, space: SearchSpace, cost: DeterministicMetric) -> None:
        self.space = space
        self.cost = cost
        self._columns = [space.paths.index(path) for path in cost.paths]

    def posterior(self, values: Sequence[Mapping[str, Any]]) -> Posterior:
        return Posterior(
            np.array([self.cost.outcome(v) for v in values]), np.zeros((len(values), len(values)))
        )

    def worst(self) -> float:
        """Return the least outcome at the ends of the parameters that decide it, and at points between them.

        Values that exclude one another have none.
        """
        outcomes = self._everywhere()
        return min([y for y in outcomes if abs(y) != NO_MISSION] or outcomes)

    def best(self) -> float:
        """Return the largest outcome at these ends and points."""
        return max(self._everywhere())

    def _everywhere(self) -> list[float]:
        points = np.random.default_rng(0).random((MOST_BETWEEN, self.space.dimension))
        parameters = [self.space.parameters[i] for i in self._columns]
        some = self.space.from_unit([0.5] * self.space.dimension)
        ends = itertools.islice(itertools.product(*(p.ends for p in parameters)), MOST_ENDS)
        at_ends = [self.cost.outcome({**some, **dict(zip(self.cost.paths, end))}) for end in ends]
        return [*at_ends, *self.at(torch.from_numpy(points)).tolist()]

    def keeps(self, outcomes: Floats, at_least: float) -> Bools:
        """Return whether each outcome is at least that, whatever a position rounds to."""
        return np.asarray(outcomes >= at_least - ROUNDING * max(1.0, abs(at_least)))

    def at(self, x: torch.Tensor) -> torch.Tensor:
        """Return (...,) at (..., inputs), whose first columns are the unit cube's; integers and choices are rounded."""
        unit = x.detach()[..., : self.space.dimension].reshape(-1, self.space.dimension).numpy()
        _, first, inverse = np.unique(unit[:, self._columns], axis=0, return_index=True, return_inverse=True)
        outcomes = np.array([self.cost.outcome(self.space.from_unit(unit[i])) for i in first])
        return torch.from_numpy(outcomes[inverse.reshape(-1)]).reshape(x.shape[:-1])
