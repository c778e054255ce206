"""Whether a configuration works at all: what missions that failed, and those that did not, say of every configuration.

A Gaussian process over labels, 1 for a mission that ended well and -1 for one that the configuration failed, as Gardner et al.
(ICML 2014) model constraints; its noise learns how much failures are chance.
"""

from __future__ import annotations

import torch

from nbv.types import Floats
from tuner.problem.search_space import SearchSpace
from tuner.surrogate.fit import fitted
from tuner.surrogate.kernel import landscape_kernel
from tuner.surrogate.many_missions import fitted_subset
from tuner.surrogate.numerics import numerics, tensor

_LEAST_SD = 0.1  # a label apart is 2: nothing is certain


class Feasibility:
    """The model; ``worked`` and ``failed`` are (n, d) and (m, d) unit positions, one a mission."""

    def __init__(self, space: SearchSpace, worked: Floats, failed: Floats, seed: int) -> None:
        ordered = [i for i in range(space.dimension) if i not in space.categorical_dimensions]
        x = torch.cat([tensor(failed), tensor(worked)])
        y = torch.ones(len(x), 1, dtype=torch.float64)
        y[: len(failed)] = -1.0
        chosen = fitted_subset(len(x))
        with numerics(seed), torch.enable_grad():  # whoever asks first
            kernel = landscape_kernel(ordered, space.categorical_dimensions)
            self._model = fitted([kernel], x[chosen], y[chosen])

    def log_chance(self, unit: torch.Tensor) -> torch.Tensor:
        """Return (...,) logarithm of the probability that a mission ends well, at (..., d) unit positions; differentiable."""
        belief = self._model(unit.unsqueeze(-2))
        mean, variance = belief.mean[..., 0], belief.variance[..., 0]
        return torch.special.log_ndtr(mean / (variance + _LEAST_SD**2).sqrt())
