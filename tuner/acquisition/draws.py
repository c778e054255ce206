"""Many proposals at once: the best of as many draws from the posterior (Thompson, Biometrika 1933; Kandasamy et al., AISTATS 2018).

Each is the best configuration of one plausible objective, so that they differ where the model is uncertain. The cost hardly
depends on their number.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch

from tuner.acquisition.constrained import Constraint, surrogate_of
from tuner.acquisition.propose import only_allowed, starting_points
from tuner.problem.search_space import Values
from tuner.surrogate.model import InstanceMeanGP
from tuner.surrogate.numerics import numerics, tensor
from tuner.surrogate.posterior import DeterministicOutcome

GLOBAL_POINTS, LOCAL_POINTS = 256, 1024
_INFEASIBLE_PENALTY = 1e6  # standard deviations: worse than all that works
_TIE_BREAK = 1e-6  # standard deviations
_VIOLATION_PENALTY = 1e3  # likewise: worse than all that keeps a limit


def draw(
    models: Sequence[InstanceMeanGP | DeterministicOutcome],
    constraint: Constraint | None,
    count: int,
    seed: int,
) -> list[Values]:
    """Return ``count`` configurations, each the best of one posterior draw that may work; no two are alike.

    A draw is over points everywhere and near the best run. With a limit of the second objective: the best of the first where
    the draw keeps it, else what comes nearest. What the configuration decides is the same in every draw.

    ``models``: a surrogate of the objective, or of each of two, or a known cost; one is a surrogate.
    """
    model = surrogate_of(models)
    with numerics(), torch.no_grad():
        near = None if constraint is None else constraint.promising(models[0])
        points = starting_points(model, seed, GLOBAL_POINTS, LOCAL_POINTS, near)
        points = np.unique([model.space.snap(x) for x in points], axis=0)
        allowed = None if constraint is None else constraint.allowed()
        if allowed is not None:
            points = only_allowed(model, points, allowed, seed)
        inputs = model.inputs(points)
        generator = torch.Generator().manual_seed(seed)
        draws, *others = (_drawn(m, inputs, count, generator) for m in models)
        if constraint is not None and allowed is None:  # of what costs the same the better one
            (second,) = others
            draws = torch.where(
                second >= constraint.floor(), draws + _TIE_BREAK * second, second - _VIOLATION_PENALTY
            )
        if model.feasibility is not None:
            # Each draw has one opinion on what works: a point's own would let some of many through.
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
    model: InstanceMeanGP | DeterministicOutcome, inputs: torch.Tensor, count: int, generator: torch.Generator
) -> torch.Tensor:
    """Return (count, points) draws on the model's own scale; an exact outcome on a standardised one."""
    if isinstance(model, InstanceMeanGP):
        normal = torch.randn(count, len(inputs), generator=generator, dtype=inputs.dtype)
        return model.model.posterior(inputs).rsample_from_base_samples(torch.Size([count]), normal)[..., 0]
    known = model.at(inputs)
    return ((known - known.mean()) / (known.std(correction=0) + _TIE_BREAK)).expand(count, -1).clone()
