"""Many proposals at once: the best of as many draws from the posterior (Thompson, Biometrika 1933; Kandasamy et al., AISTATS 2018).

Each is good under something that may be true, so that they differ where the missions leave it open. The cost hardly depends on
their number.
"""

from __future__ import annotations

import numpy as np
import torch
from botorch.utils.sampling import manual_seed

from tuner.acquisition.over_rocks import WorldOutcomes
from tuner.acquisition.propose import over_worlds, starting_points
from tuner.problem.options import Risk
from tuner.problem.search_space import Values
from tuner.surrogate.model import RockMeanGP
from tuner.surrogate.numerics import numerics, tensor
from tuner.surrogate.risk import risk_of

GLOBAL_POINTS, LOCAL_POINTS = 256, 1024
_FAILS = 1e6  # standard deviations: worse than all that works


def draw_best(model: RockMeanGP, count: int, seed: int, risk: Risk = "mean") -> list[Values]:
    """``count`` configurations, each the best of a draw among points everywhere and near the best flown; no two alike."""
    with numerics(seed), torch.no_grad():
        points = starting_points(model, seed, GLOBAL_POINTS, LOCAL_POINTS)
        points = np.unique([model.space.snap(x) for x in points], axis=0)
        inputs = model.inputs(points)
        with manual_seed(seed):
            if over_worlds(model, risk):
                draws = risk_of(WorldOutcomes(model).posterior(inputs).rsample(torch.Size([count])), risk)
            else:
                draws = model.model.posterior(inputs).rsample(torch.Size([count]))[..., 0]
        if (
            model.feasibility is not None
        ):  # each draw has one opinion on what works: a point's own would let some of many through
            chance = model.feasibility.log_chance(tensor(points)).exp()
            with manual_seed(seed):
                draws[torch.rand(count, 1, dtype=chance.dtype) > chance] -= _FAILS
        chosen: list[int] = []
        for draw in draws:
            if len(chosen) < len(points):
                draw[chosen] = -torch.inf
            chosen.append(int(draw.argmax()))
    return [model.space.from_unit(points[i]) for i in chosen]
