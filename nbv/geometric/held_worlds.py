"""The last few worlds, in this process's memory: a campaign in one process loads each once."""

from __future__ import annotations

from nbv.cache import Store
from nbv.config import MissionConfig
from nbv.geometric.world import GeometricWorld, load_world
from nbv.rocks import Rock

MAX_HELD = 16
_held: dict[tuple[object, ...], GeometricWorld] = {}


def world_of(rock: Rock, config: MissionConfig, store: Store | None) -> GeometricWorld:
    """The rock's world; from memory, from the store, or made."""
    # All that `nbv.geometric.world` reads, and a little more.
    key = (
        rock.sha256,
        config.camera,
        config.scene,
        config.ground,
        config.seed,
        config.pool,
        config.target_m,
        config.shared.box_half_extent_m,
    )
    world = _held.pop(key, None)
    if world is None:
        world = load_world(rock, config, store)
        while len(_held) >= MAX_HELD:
            _held.pop(next(iter(_held)))
    _held[key] = world  # most recently used last
    return world


def forget_worlds() -> None:
    """Hold none."""
    _held.clear()
