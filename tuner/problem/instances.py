"""Where a mission is run: a rock under a condition."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

from nbv.config import IDEAL
from nbv.errors import UserError


class Instance(NamedTuple):
    rock: str  # name or mesh file
    condition: str = IDEAL

    @property
    def label(self) -> str:
        """``slab`` under ``ideal``, ``slab, field`` under another condition."""
        return self.rock if self.condition == IDEAL else f"{self.rock}, {self.condition}"

    @property
    def file_name(self) -> str:
        """Part of a directory's name: ``slab``, or ``slab_field`` under condition ``field``; other characters become dashes."""
        safe = "".join(c if c.isalnum() or c in "-_." else "-" for c in Path(self.rock).stem) or "rock"
        return safe if self.condition == IDEAL else f"{safe}_{self.condition}"


def instances_over(rocks: Sequence[str], conditions: Sequence[str]) -> tuple[Instance, ...]:
    """Return every rock under every condition, once, in an order in which neighbours differ in both where they can."""
    return tuple(
        Instance(rock, conditions[(i + turn) % len(conditions)])
        for turn in range(len(conditions))
        for i, rock in enumerate(rocks)
    )


def conditions_of(instances: Iterable[Instance]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(instance.condition for instance in instances))


def rocks_of(instances: Iterable[Instance]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(instance.rock for instance in instances))


def require_rocks(rocks: Sequence[str]) -> None:
    """Raise `UserError` where there is none, or one is named twice."""
    if not rocks:
        raise UserError("there are no rocks; name at least one")
    for rock in rocks:
        if rocks.count(rock) > 1:
            raise UserError(f"rock {rock!r} is named twice; name each rock once")
