"""The parts of a search space whose best configuration is asked for by name.

*Tuned gate* is what the paper proposes: thresholds, weights and the repairing scorer, with seeds, candidate pool and numbers as they
are. *Tuned planner* may change seeds and pool besides, and plans at least `LEAST_PLANNED` views. A space that tunes no gate, or a
goal with a limit, has one answer, *Tuned*.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from nbv.types import Bools, Floats
from tuner.problem.search_space import SearchSpace, Values

TUNED, TUNED_GATE, TUNED_PLANNER = "tuned", "tuned-gate", "tuned-planner"
LEAST_PLANNED = 3  # views that a tuned planner plans
CHOOSES_VIEWS = ("gate.", "covis.", "b_aware.", "predicted.", "shared.", "plugins.")
SEEDS, PHOTOGRAPHS = "seed.count", "stop.max_photographs"


@dataclass(frozen=True)
class Region:
    """Part of a search space: some parameters are held, others have an upper bound."""

    name: str
    space: SearchSpace
    held: Values = field(default_factory=dict)
    at_most: Mapping[str, float] = field(default_factory=dict)

    def contains(self, values: Mapping[str, Any]) -> bool:
        """Return whether a configuration lies in the region."""
        return all(values[path] == value for path, value in self.held.items()) and all(
            values[path] <= bound for path, bound in self.at_most.items()
        )

    def with_gate_of(self, values: Mapping[str, Any]) -> Region:
        """Return the part of the region in which views are chosen as at ``values``."""
        gate = {path: values[path] for path in self.space.paths if path.startswith(CHOOSES_VIEWS)}
        return dataclasses.replace(self, held={**self.held, **gate})

    def inside(self, unit: Floats) -> Bools:
        """Return (n,) which of (n, d) unit positions lie in the region."""
        return np.all(np.abs(self.project(unit) - unit) < 1e-9, axis=-1)

    def project(self, unit: Floats) -> Floats:
        """Return (..., d) unit positions moved into the region, parameter by parameter."""
        moved = unit.copy()
        for i, p in enumerate(self.space.parameters):
            if p.path in self.held:
                moved[..., i] = p.to_unit(self.held[p.path])
            elif p.path in self.at_most:
                moved[..., i] = np.minimum(moved[..., i], p.to_unit(self.at_most[p.path]))
        return moved


def regions_of(space: SearchSpace, default: Values, *, limited: bool) -> tuple[Region, ...]:
    """Return the regions of a `fitted` space; ``limited``: whether the goal has a limit."""
    chooses = [path for path in space.paths if path.startswith(CHOOSES_VIEWS)]
    if limited or not chooses:
        return (Region(TUNED, space),)
    plan = {path: default[path] for path in space.paths if not path.startswith(CHOOSES_VIEWS)}
    gate = Region(TUNED_GATE, space, plan)
    if not plan:
        return (gate,)
    number = space.base.get(PHOTOGRAPHS)
    most = {SEEDS: number - LEAST_PLANNED} if number and SEEDS in space.paths else {}
    return gate, Region(TUNED_PLANNER, space, at_most=most)
