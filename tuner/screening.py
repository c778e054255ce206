"""Screening: a search with a low fidelity before the first expensive mission.

Geometric missions rank configurations about as well as a second photogrammetric replicate does
(docs/results/geometric_fidelity.md) and take a thirtieth of the time. So the same optimiser first looks for the best
configuration of the low fidelity, g; half of the initial design are the best it found instead of Sobol points. g's
landscape enters the surrogate of the full fidelity as a feature,

    f(x) = rho g(x) + delta(x),   rho ~ N(0, v)

(autoregressive co-kriging, Kennedy and O'Hagan 2000, with g's posterior mean plugged in). Whether the landscapes agree
is decided by the full fidelity's missions at every ask: the feature is used where the marginal likelihood prefers it.
All cheap missions come before the first expensive one, so that the last third of a budget is full fidelity.
"""

from __future__ import annotations

import functools
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from tuner.gp_options import GPOptions
from tuner.history import Observation
from tuner.initial_design import initial_design_size
from tuner.search_space import SearchSpace, Values
from tuner.slots import next_slot

if TYPE_CHECKING:
    from nbv.types import Floats
    from tuner.surrogate import RockMeanGP

# As many as were measured (docs/results/optimiser_comparison.md, "On photogrammetry"): 31 s of one core, asks included.
CHEAP_MISSIONS = 96
_REPLICATES = 2
# Root mean square distance in the unit cube between screened configurations of the initial design.
_APART = 0.15
_MIN_OBSERVATIONS = 20

# (configuration, rock, replicate) -> outcome, larger is better; None: failed
CheapMission = Callable[[Values, str, int], float | None]


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
    def _model(self) -> RockMeanGP:
        from tuner.samplers import surrogate_settings
        from tuner.surrogate import RockMeanGP

        settings = surrogate_settings(GPOptions(), self.space)
        return RockMeanGP(self.space, self.observations, self.rocks, 0, settings)

    @functools.cached_property
    def feature(self) -> Feature:
        """g, standardised over the missions flown."""
        return Feature(self._model)

    def best(self, count: int) -> list[Values]:
        """The configurations flown with the best g that are apart from each other; at most ``count``.

        What has not flown every slot is marked down by its share of a mission's noise.
        """
        from tuner.verification import distinct_configurations, markdown

        gp = self._model
        seen = distinct_configurations(self.space, gp.observations)
        doubt = markdown(self.space, self.observations, seen, self.rocks, gp.noise_sd)
        chosen: list[tuple[Values, Floats]] = []
        for index in np.argsort(doubt - gp.posterior(seen).mean, kind="stable"):
            unit = self.space.to_unit(seen[index])
            if all(np.sqrt(np.mean((unit - other) ** 2)) > _APART for _, other in chosen):
                chosen.append((seen[index], unit))
            if len(chosen) == count:
                break
        return [values for values, _ in chosen]

    def to_json(self) -> str:
        """For a file beside the ledger."""
        rows = [[dict(o.values), o.rock, o.outcome, o.replicate] for o in self.observations]
        return json.dumps({"rocks": list(self.rocks), "missions": rows})

    @staticmethod
    def from_json(text: str, space: SearchSpace) -> Screen:
        """The inverse of ``to_json``; ``ValueError`` or ``KeyError`` where it is not."""
        tree = json.loads(text)
        observations = [Observation(i, v, r, k, y, y) for i, (v, r, y, k) in enumerate(tree["missions"])]
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
    *,
    trusted_default: bool = False,
) -> Screen:
    """Fly the cheap missions: ``CHEAP_MISSIONS`` of our own sampler's, from the default on.

    ``on_mission`` hears ``(flown, total)`` after each. ``trusted_default``: chosen by hand, so the design may stay near it.
    """
    from tuner.samplers import GPSampler, SamplerSettings, derived_seed

    initial = initial_design_size(space.dimension, CHEAP_MISSIONS, trusted_default=trusted_default)
    # Another seed than the campaign's: other Sobol points than those of its own initial design.
    sampler = GPSampler(
        SamplerSettings(
            space, dict(default), tuple(rocks), derived_seed(seed, CHEAP_MISSIONS), initial, _REPLICATES,
            budget=CHEAP_MISSIONS, trusted_default=trusted_default,
        )
    )  # fmt: skip
    history: list[Observation] = []
    while len(history) < CHEAP_MISSIONS:
        proposal = sampler.ask(history, [])
        rock, replicate = next_slot(rocks, _REPLICATES, history, proposal)
        y = fly(proposal.values, rock, replicate)
        history.append(
            Observation(len(history), proposal.values, rock, replicate, y, y, memory=proposal.memory)
        )
        on_mission(len(history), CHEAP_MISSIONS)
    return Screen(space, tuple(rocks), tuple(history))
