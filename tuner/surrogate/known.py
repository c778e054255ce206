"""What needs no surrogate: an exact cost where a surrogate of an objective is expected."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch

from nbv.types import Bools, Floats
from tuner.problem.exact_costs import ExactCost
from tuner.problem.search_space import SearchSpace
from tuner.surrogate.posterior import Posterior

ROUNDING = 1e-9
MOST_ENDS = 256


class KnownOutcome:
    """An exact cost, oriented so that larger is better; the same on every rock."""

    def __init__(self, space: SearchSpace, cost: ExactCost) -> None:
        self.space = space
        self.cost = cost
        self._columns = [space.paths.index(path) for path in cost.paths]

    def posterior(self, values: Sequence[Mapping[str, Any]]) -> Posterior:
        """Return the outcomes as a posterior without uncertainty."""
        return Posterior(
            np.array([self.cost.outcome(v) for v in values]), np.zeros((len(values), len(values)))
        )

    def worst(self) -> float:
        """Return the least outcome at the ends of the parameters that decide it."""
        own = [self.space.parameters[i] for i in self._columns]
        some = self.space.from_unit([0.5] * self.space.dimension)
        ends = itertools.islice(itertools.product(*(p.ends for p in own)), MOST_ENDS)
        return min(self.cost.outcome({**some, **dict(zip(self.cost.paths, end))}) for end in ends)

    def keeps(self, outcomes: Floats, at_least: float) -> Bools:
        """Return whether each outcome is at least that, whatever a position rounds to."""
        return np.asarray(outcomes >= at_least - ROUNDING * max(1.0, abs(at_least)))

    def at(self, x: torch.Tensor) -> torch.Tensor:
        """Return (...,) at (..., inputs), whose first columns are the unit cube's; integers and choices are rounded."""
        unit = x.detach()[..., : self.space.dimension].reshape(-1, self.space.dimension).numpy()
        _, first, inverse = np.unique(unit[:, self._columns], axis=0, return_index=True, return_inverse=True)
        found = np.array([self.cost.outcome(self.space.from_unit(unit[i])) for i in first])
        return torch.from_numpy(found[inverse.reshape(-1)]).reshape(x.shape[:-1])
