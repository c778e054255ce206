"""Many proposals at once by Thompson sampling (Thompson, Biometrika 1933; Kandasamy et al., AISTATS 2018).

Each is the best configuration of one plausible objective, so that they differ where the model is uncertain. The cost hardly
depends on their number.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch

from tuner.acquisition.constrained import Constraint
from tuner.acquisition.propose import starting_points
from tuner.problem.search_space import Values
from tuner.surrogate.model import InstanceMeanGP
from tuner.surrogate.numerics import numerics, tensor

GLOBAL_POINTS, LOCAL_POINTS = 256, 1024
_INFEASIBLE_PENALTY = 1e6  # standard deviations: puts what would fail below all that works
_TIE_BREAK = 1e-6  # standard deviations
_VIOLATION_PENALTY = 1e3  # likewise: puts what violates the constraint below all that meets it


def thompson_configurations(
    models: Sequence[InstanceMeanGP],
    constraint: Constraint | None,
    count: int,
    seed: int,
) -> list[Values]:
    """Return ``count`` configurations, each the best of one posterior draw that may work; no two are alike.

    Draws are over candidate configurations from the whole space and near the best that was run. With an outcome constraint a
    draw's best has the best objective among those that meet it in this draw, or else the least violation.
    """
    model = models[0]
    with numerics(), torch.no_grad():
        near = None if constraint is None else constraint.promising(model)
        points = starting_points(model, seed, GLOBAL_POINTS, LOCAL_POINTS, near)
        points = np.unique([model.space.snap(x) for x in points], axis=0)
        inputs = model.inputs(points)
        generator = torch.Generator().manual_seed(seed)
        draws, *others = (_drawn(m, inputs, count, generator) for m in models)
        if constraint is not None:  # of what costs the same the better one
            (second,) = others
            draws = torch.where(
                second >= constraint.floor(), draws + _TIE_BREAK * second, second - _VIOLATION_PENALTY
            )
        if model.feasibility is not None:
            # One random number per draw decides what fails in it: with one per point, some of many points would pass.
            chance = model.feasibility.log_chance(tensor(points)).exp()
            refused = torch.rand(count, 1, dtype=chance.dtype, generator=generator) > chance
            draws[refused] -= _INFEASIBLE_PENALTY
    chosen: list[int] = []
    for one in draws:
        if len(chosen) < len(points):
            one[chosen] = -torch.inf
        chosen.append(int(one.argmax()))
    return [model.space.from_unit(points[i]) for i in chosen]


def _drawn(
    model: InstanceMeanGP, inputs: torch.Tensor, count: int, generator: torch.Generator
) -> torch.Tensor:
    """Return (count, points) draws on the model's own scale."""
    normal = torch.randn(count, len(inputs), generator=generator, dtype=inputs.dtype)
    return model.model.posterior(inputs).rsample_from_base_samples(torch.Size([count]), normal)[..., 0]
