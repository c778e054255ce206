"""Worlds to fly in: a condition, with photographs or without."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from nbv.config import IDEAL_CONDITION, Condition
from nbv.errors import UserError
from tuner.missions.registry import DEFAULT_FIDELITY, require_fidelity


@dataclass(frozen=True)
class World:
    """What is laid over every configuration, and who flies it."""

    condition: Condition = IDEAL_CONDITION
    fidelity: str = DEFAULT_FIDELITY  # of tuner.missions.registry, or module:function


def worlds(conditions: Sequence[Condition], fidelities: Sequence[str]) -> dict[str, World]:
    """Every combination, by name.

    Raises
    ------
    UserError
        An unknown name, or one that is given twice.
    """
    found: dict[str, World] = {}
    for condition in conditions:
        for fidelity in fidelities:
            require_fidelity(fidelity)
            name = f"{condition.name}-{fidelity}"
            if name in found:
                raise UserError(f"world {name!r} is asked for twice; name it once")
            found[name] = World(condition, fidelity)
    return found
