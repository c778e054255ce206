"""Worlds to fly in: which renderer makes the photographs, or no photographs at all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from nbv.config import RENDERERS, MissionConfig
from nbv.errors import UserError
from tuner.missions.registry import DEFAULT_RUNNER, is_geometric, registered

RENDERER = "scene.backend"


@dataclass(frozen=True)
class World:
    """What is laid over every configuration, and who flies it."""

    values: dict[str, Any] = field(default_factory=dict)  # by parameter path
    runner: str = DEFAULT_RUNNER  # of tuner.missions.registry, or module:function

    def config(self, config: MissionConfig) -> MissionConfig:
        """``config`` in this world; ``UserError`` for a value that no mission takes."""
        return config.with_values(self.values)


def worlds(renderers: Sequence[str], fidelities: Sequence[str]) -> dict[str, World]:
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
    for fidelity in fidelities:
        for renderer in [""] if is_geometric(registered(fidelity)) else renderers:
            name = renderer or fidelity
            if name in found:
                raise UserError(f"world {name!r} is asked for twice; name it once")
            found[name] = World({RENDERER: renderer} if renderer else {}, fidelity)
    return found
