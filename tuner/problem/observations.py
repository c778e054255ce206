"""What is known at one moment of a campaign: finished and running missions, as plain values."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from nbv.config import IDEAL
from tuner.problem.worlds import World


@dataclass(frozen=True)
class Observation:
    """One finished mission: one configuration on one rock with one replicate."""

    number: int  # trial number in the ledger
    values: Mapping[str, Any]  # tuned parameters by path
    rock: str
    replicate: int
    outcome: float | None  # oriented so that larger is better; None: failed, i.e. infeasible
    raw: float | None = None  # the metric as measured
    reason: str = ""  # why it failed
    # Outcome of a second objective, oriented alike; None: none asked for, or missing.
    second: float | None = None
    condition: str = IDEAL  # its name

    @property
    def feasible(self) -> bool:
        """Whether the mission produced the objective's metric."""
        return self.outcome is not None

    @functools.cached_property
    def world(self) -> World:
        """The world in which it was flown."""
        return World(self.rock, self.condition)


@dataclass(frozen=True)
class Pending:
    """One mission in flight."""

    number: int
    values: Mapping[str, Any]
    rock: str
    replicate: int
    condition: str = IDEAL

    @functools.cached_property
    def world(self) -> World:
        """The world in which it flies."""
        return World(self.rock, self.condition)


@dataclass(frozen=True)
class Proposal:
    """What to fly next; the campaign's schedule decides ``rock``, ``condition`` and ``replicate`` where they are None."""

    values: dict[str, Any]
    why: dict[str, Any]  # JSON: at least {"sampler": ..., "phase": ...}
    rock: str | None = None
    replicate: int | None = None
    condition: str = IDEAL  # of ``rock``

    @property
    def world(self) -> World | None:
        """The world in which to fly it."""
        return None if self.rock is None else World(self.rock, self.condition)
