"""Screening: what many cheap missions of a low fidelity say before the first expensive one.

The cheap missions come first, all of them: at 1/200 of a mission's cost, several hundred cost less than two. Their
own Gaussian process gives a mean landscape g, which enters the surrogate of the full fidelity as a feature,

    f(x) = rho g(x) + delta(x),   rho ~ N(0, v)

(autoregressive co-kriging, Kennedy and O'Hagan 2000, with g plugged in). Whether the landscapes agree is decided by
the full fidelity's missions at every ask: the feature is used where the marginal likelihood prefers it. And half
of the initial design are the best configurations of g instead of Sobol points.
"""

from __future__ import annotations

import functools
import json
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from scipy.stats import qmc

from nbv.types import Floats
from tuner.history import Observation
from tuner.search_space import SearchSpace, Values

# Cheap missions per parameter: spread out, then near the best of those.
SPREAD_PER_PARAMETER = 30
NEAR_PER_PARAMETER = 15
_NEAR_BEST = 8
_NEAR_SD = 0.1
_APART = (
    0.15  # root mean square distance in the unit cube between screened configurations of the initial design
)
_MIN_OBSERVATIONS = 20

# (configuration, rock) -> outcome, larger is better; None: failed
CheapMission = Callable[[Values, str], float | None]


@dataclass(frozen=True)
class Screen:
    """The cheap missions flown."""

    space: SearchSpace
    rocks: tuple[str, ...]
    observations: tuple[Observation, ...]

    @property
    def usable(self) -> bool:
        """Whether enough of them succeeded."""
        return sum(o.feasible for o in self.observations) >= _MIN_OBSERVATIONS

    @functools.cached_property
    def _model(self) -> Any:
        from tuner.surrogate import RockMeanGP, SurrogateSettings

        # Next to no noise: what a rock's own spread is off by, from a third or so of the missions, would dominate.
        settings = SurrogateSettings(slots=False, rock_scales=False)
        return RockMeanGP(self.space, self.observations, self.rocks, 0, settings)

    @functools.cached_property
    def feature(self) -> Feature:
        """g, standardised over the spread-out missions."""
        return Feature(self._model)

    def best(self, count: int) -> list[Values]:
        """The configurations flown with the best g that are apart from each other; at most ``count``."""
        unit = np.unique(self._model.unit, axis=0)
        level = self.feature(self._model.inputs(unit)).numpy()
        chosen: list[Floats] = []
        for index in np.argsort(-level):
            if all(np.sqrt(np.mean((unit[index] - u) ** 2)) > _APART for u in chosen):
                chosen.append(unit[index])
            if len(chosen) == count:
                break
        return [self.space.from_unit(u) for u in chosen]

    def to_json(self) -> str:
        """For a file beside the ledger."""
        rows = [[dict(o.values), o.rock, o.outcome] for o in self.observations]
        return json.dumps({"rocks": list(self.rocks), "missions": rows})

    @staticmethod
    def from_json(text: str, space: SearchSpace) -> Screen:
        """The inverse of ``to_json``; ``ValueError`` or ``KeyError`` where it is not."""
        tree = json.loads(text)
        observations = [Observation(i, v, r, 0, y, y) for i, (v, r, y) in enumerate(tree["missions"])]
        return Screen(space, tuple(tree["rocks"]), tuple(observations))


class Feature:
    """Posterior mean of a fitted ``RockMeanGP`` at no rock, standardised: ``(..., d + 2)`` inputs to ``(...,)``."""

    def __init__(self, gp: Any) -> None:
        model = gp.model
        self._d, self._kernel, self._x = gp.space.dimension, model.covar_module, model.train_inputs[0]
        with torch.no_grad():
            noise = model.likelihood.noise * torch.eye(len(self._x), dtype=torch.float64)
            residual = model.train_targets - model.mean_module.constant
            self._weights = torch.linalg.solve(self._kernel.forward(self._x, self._x) + noise, residual)
            self._centre, self._scale = 0.0, 1.0
            level = self(gp.inputs(gp.unit))
        self._centre, self._scale = float(level.mean()), max(1e-9, float(level.std()))

    def __call__(self, x: torch.Tensor) -> torch.Tensor:
        """The rock and slot columns are ignored."""
        bare = torch.cat([x[..., : self._d], torch.full_like(x[..., self._d :], -1.0)], dim=-1)
        level = self._kernel.forward(bare, self._x) @ self._weights
        return (level - self._centre) / self._scale


def screen(
    space: SearchSpace,
    rocks: Sequence[str],
    default: Mapping[str, Any],
    fly: CheapMission,
    seed: int,
    on_mission: Callable[[int, int], None] = lambda done, total: None,
) -> Screen:
    """Fly the cheap missions: Sobol points, then points near the best of them; rocks in turn.

    ``on_mission`` hears ``(flown, total)`` after each.
    """
    spread, near = SPREAD_PER_PARAMETER * space.dimension, NEAR_PER_PARAMETER * space.dimension
    observations: list[Observation] = []

    def go(values: Values) -> None:
        rock = rocks[len(observations) % len(rocks)]
        y = fly(values, rock)
        observations.append(Observation(len(observations), values, rock, 0, y, y))
        on_mission(len(observations), spread + near)

    engine = qmc.Sobol(space.dimension, scramble=True, rng=seed)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # balance needs powers of two
        points = engine.random(spread - 1)
    go(dict(default))
    for point in points:
        go(space.from_unit(point))
    first = Screen(space, tuple(rocks), tuple(observations))
    if not first.usable:
        return first
    rng = np.random.default_rng(seed)
    best = np.array([space.to_unit(v) for v in first.best(_NEAR_BEST)])
    for i in range(near):
        step = _NEAR_SD * rng.standard_normal(space.dimension) * (rng.random(space.dimension) < 0.5)
        go(space.from_unit(np.clip(best[i % len(best)] + step, 0.0, 1.0)))
    return Screen(space, tuple(rocks), tuple(observations))
