"""The Pareto front of what was flown, once a model has said what it believes of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from nbv.types import Floats
from tuner.problem.objective import Objective


@dataclass(frozen=True)
class FrontPoint:
    """A configuration that no other flown one beats in both objectives, by posterior means over the rocks."""

    values: dict[str, Any]
    first: float  # metrics' units, as measured
    first_sd: float
    second: float
    second_sd: float

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON form."""
        return asdict(self)


def pareto_front(points: Sequence[FrontPoint], objectives: tuple[Objective, Objective]) -> list[FrontPoint]:
    """Return the points that no other one dominates, in the same order."""
    level: Floats = np.array([[p.first, p.second] for p in points]) * [o.sign for o in objectives]
    return [p for p, own in zip(points, level) if not ((level >= own).all(1) & (level > own).any(1)).any()]
