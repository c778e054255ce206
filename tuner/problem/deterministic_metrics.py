"""Costs that the configuration decides: they are computed, never modelled.

The photographs of a mission are its seeds and its budget of captures, unless something may end it early. Flight time, early stops and whatever a mission measures are left to a model.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from nbv.config import MissionConfig
from nbv.errors import UserError
from tuner.problem.objective import Objective
from tuner.problem.observations import Observation
from tuner.problem.search_space import SearchSpace

PHOTOGRAPHS = "costs.images"
DECIDES_PHOTOGRAPHS = ("seed.count", "stop.adaptive_budget", "stop.max_photographs")
CRITERION = "stop.criterion"
NO_MISSION = 1e6  # the cost of values that exclude one another
_SAME = 1e-9


@dataclass(frozen=True)
class DeterministicMetric:
    objective: Objective
    paths: tuple[str, ...]  # the tuned parameters that decide it
    _of: Callable[[Mapping[str, Any]], float]
    _known: dict[tuple[Any, ...], float] = field(default_factory=dict, compare=False)

    def of(self, values: Mapping[str, Any]) -> float:
        """Return the metric of a mission at ``values``, in its unit."""
        key = tuple(values[path] for path in self.paths)
        if key not in self._known:
            self._known[key] = self._of(values)
        return self._known[key]

    def outcome(self, values: Mapping[str, Any]) -> float:
        """Return the metric of a mission at ``values``, oriented so that larger is better."""
        return self.objective.sign * self.of(values)

    def agrees(self, missions: Iterable[tuple[Mapping[str, Any], float]]) -> bool:
        """Return whether the cost computed is that of every mission (values and outcome): a pool may run empty."""
        return all(
            math.isclose(self.outcome(values), measured, rel_tol=_SAME) for values, measured in missions
        )


@dataclass(frozen=True)
class DeterministicMetrics:
    """The objective and the second one as functions of the configuration; None where only a mission can tell."""

    first: DeterministicMetric | None = None
    second: DeterministicMetric | None = None

    def confirmed_by(self, history: Sequence[Observation]) -> DeterministicMetrics:
        """Return those that every mission so far has confirmed; a surrogate models the others."""
        done = [o for o in history if o.outcome is not None]
        outcomes = [(o.values, o.outcome) for o in done if o.outcome is not None]
        seconds = [(o.values, o.second) for o in done if o.second is not None]
        return DeterministicMetrics(
            self.first if self.first is not None and self.first.agrees(outcomes) else None,
            self.second if self.second is not None and self.second.agrees(seconds) else None,
        )


def with_second_first(history: Sequence[Observation]) -> list[Observation]:
    """Return the history with the second objective's outcomes in the place of the first's, which are computed."""
    both = [o for o in history if o.outcome is None or o.second is not None]
    return [replace(o, outcome=o.second, second=o.outcome) for o in both]


def photographs_metric(
    space: SearchSpace,
    config: Callable[[Mapping[str, Any]], MissionConfig],
    default: Mapping[str, Any],
    objective: Objective,
) -> DeterministicMetric | None:
    """Return the objective where it is the number of photographs; None where only a mission can tell it.

    ``default``: the default values; what is not tuned is read from their configuration.
    """
    base, tuned = config(default), {path for p in space.parameters for path in (p.path, *p.also)}
    if objective.metric != PHOTOGRAPHS or base.stop.may_end_early or CRITERION in tuned:
        return None

    def photographs(values: Mapping[str, Any]) -> float:
        try:
            mission = config(values)
            return float(mission.seed.total + mission.adaptive_budget)
        except UserError:
            return NO_MISSION

    deciding = tuple(
        p.path for p in space.parameters if any(path in DECIDES_PHOTOGRAPHS for path in (p.path, *p.also))
    )
    return DeterministicMetric(objective, deciding, photographs)
