"""Worlds to fly in: a condition, and which renderer makes its photographs, or no photographs at all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from nbv.config import IDEAL_CONDITION, RENDERERS, Condition, MissionConfig
from nbv.errors import UserError
from tuner.missions.registry import DEFAULT_FIDELITY, is_geometric, registered

RENDERER = "scene.backend"


@dataclass(frozen=True)
class World:
    """What is laid over every configuration, and who flies it."""

    condition: Condition = IDEAL_CONDITION
    renderer: str = ""  # empty: the configuration's
    fidelity: str = DEFAULT_FIDELITY  # of tuner.missions.registry, or module:function

    def config(self, config: MissionConfig) -> MissionConfig:
        """``config`` with this world's renderer; its condition is the plan's."""
        return config.with_values({RENDERER: self.renderer}) if self.renderer else config


def worlds(
    conditions: Sequence[Condition], renderers: Sequence[str], fidelities: Sequence[str]
) -> dict[str, World]:
    """Every combination, by name; geometric missions have no photographs, so they are one world for all renderers.

    Raises
    ------
    UserError
        An unknown name, or one that is given twice.
    """
    for renderer in renderers:
        if renderer not in RENDERERS:
            raise UserError(f"unknown renderer {renderer!r}; there are {', '.join(RENDERERS)}")
    found: dict[str, World] = {}
    for condition in conditions:
        for fidelity in fidelities:
            for renderer in [""] if is_geometric(registered(fidelity)) else renderers:
                name = f"{condition.name}-{renderer or fidelity}"
                if name in found:
                    raise UserError(f"world {name!r} is asked for twice; name it once")
                found[name] = World(condition, renderer, fidelity)
    return found
