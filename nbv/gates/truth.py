"""What an oracle gate asks of the ground truth, whatever that is made of: a surface, or tracks of photographs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from nbv.config import MissionConfig
from nbv.types import Bools, Floats, PlanningState


@dataclass(frozen=True)
class Coverage:
    """Which samples are covered in one state, and how far the others have come."""

    covered: Bools  # (S,)
    visited_m: Floats  # (V, 3); used by "matchable" only
    partners: NDArray[np.int16] | None = None  # (V, S), "matchable" only; see `nbv.geometry.matchability`


class Oracle(Protocol):
    """What an oracle gate may ask of the ground truth, whatever that is made of."""

    @property
    def config(self) -> MissionConfig:
        """Its ``gate.oracle_*``."""

    def coverage(self, state: PlanningState) -> Coverage:
        """What is covered before the next capture."""

    def gain(self, position_m: Floats, coverage: Coverage) -> float:
        """What a view from ``position_m`` (3,) would add."""
