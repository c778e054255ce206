"""Where a mission is run: a rock under a condition.

The rock may be a family of rocks: ``any-cleft`` is another cleft with every replicate. A replicate of such an instance is a
rock, so what replicates share (a block's offset) is what a rock has of its own, and the mean over new replicates is the mean
over the family.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

from nbv.config import IDEAL
from nbv.errors import UserError
from nbv.rocks.families import ANY, ANY_SHAPES, EVERY, FAMILIES, HELD_OUT_FROM, SHAPES, VALIDATION_FROM


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


def family_of(rock: str) -> str | None:
    """Return the family that a name such as ``any-cleft`` stands for; None for a rock."""
    prefix, _, family = rock.partition("-")
    return family if prefix == ANY and family in EVERY else None


def with_families(rocks: Iterable[str]) -> list[str]:
    """Return ``rocks`` with ``any`` as one name for every family of rocks, and ``any-shapes`` of shapes.

    Raises `UserError`: there is no such family, or some are rocks and some are families.
    """
    meant = {kind: [f"{ANY}-{f}" for f in of] for kind, of in ((ANY, FAMILIES), (ANY_SHAPES, SHAPES))}
    names = [name for rock in rocks for name in meant.get(rock, [rock])]
    for rock in names:
        if rock.startswith(f"{ANY}-") and not family_of(rock):
            raise UserError(
                f"there is no family {rock[len(ANY) + 1 :]!r} of rocks; choose from {', '.join(EVERY)}, or {ANY_SHAPES}"
            )
    drawn = [rock for rock in names if family_of(rock)]
    if drawn and len(drawn) < len(names):
        other = next(rock for rock in names if rock not in drawn)
        raise UserError(
            f"{drawn[0]} is a family of rocks and {other!r} is a rock; name families alone, or rocks alone"
        )
    return names


def require_rocks(rocks: Sequence[str]) -> None:
    """Raise `UserError` where there is none, or one is named twice."""
    if not rocks:
        raise UserError("there are no rocks; name at least one")
    for rock in rocks:
        if rocks.count(rock) > 1:
            raise UserError(f"rock {rock!r} is named twice; name each rock once")


def are_drawn(rocks: Sequence[str]) -> bool:
    """Return whether the names are of families."""
    return any(family_of(rock) for rock in rocks)


def training_rock(rock: str, replicate: int, seed: int) -> str:
    """Return the rock that a replicate of a family is in a campaign of that seed, such as ``cleft-4711``; a rock is itself."""
    family = family_of(rock)
    return rock if family is None else f"{family}-{(seed * 1009 + replicate) % VALIDATION_FROM}"


def held_out_rocks_of(rocks: Iterable[str], count: int) -> list[str]:
    """Return the first ``count`` held-out rocks of every family, families in turn."""
    families = [family_of(rock) for rock in rocks]
    return [f"{family}-{HELD_OUT_FROM + k}" for k in range(count) for family in families]
