"""Where a mission is flown: a rock under a condition."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

from nbv.config import IDEAL


class World(NamedTuple):
    """A rock under a condition."""

    rock: str  # name or mesh file
    condition: str = IDEAL

    @property
    def label(self) -> str:
        """``slab`` under ``ideal``, ``slab, field`` under another condition."""
        return self.rock if self.condition == IDEAL else f"{self.rock}, {self.condition}"

    @property
    def file_name(self) -> str:
        """``slab`` or ``slab_field``, whatever the rock is called."""
        safe = "".join(c if c.isalnum() or c in "-_." else "-" for c in Path(self.rock).stem) or "rock"
        return safe if self.condition == IDEAL else f"{safe}_{self.condition}"


Place = World | str  # a rock's name alone: that rock under ``ideal``


def worlds_of(places: Iterable[Place]) -> tuple[World, ...]:
    """Return ``places`` as worlds; a rock's name alone means that rock under ``ideal``."""
    return tuple(World(place) if isinstance(place, str) else place for place in places)


def worlds_over(rocks: Sequence[str], conditions: Sequence[str]) -> tuple[World, ...]:
    """Return every rock under every condition, once, in an order in which neighbours differ in both where they can."""
    return tuple(
        World(rock, conditions[(i + turn) % len(conditions)])
        for turn in range(len(conditions))
        for i, rock in enumerate(rocks)
    )


def conditions_of(worlds: Iterable[World]) -> tuple[str, ...]:
    """Return each condition once, in order."""
    return tuple(dict.fromkeys(world.condition for world in worlds))


def rocks_of(worlds: Iterable[World]) -> tuple[str, ...]:
    """Return each rock once, in order."""
    return tuple(dict.fromkeys(world.rock for world in worlds))
