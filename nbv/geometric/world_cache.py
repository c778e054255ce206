"""The last few worlds in this process's memory: a campaign in one process loads each once."""

from __future__ import annotations

from nbv.cache import Store
from nbv.config import MissionConfig
from nbv.geometric.world import GeometricWorld, load_world
from nbv.rocks import Rock

MOST_WORLDS = 16
_worlds: dict[tuple[object, ...], GeometricWorld] = {}


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
    world = _worlds.pop(key, None)
    if world is None:
        world = load_world(rock, config, store)
        while len(_worlds) >= MOST_WORLDS:
            _worlds.pop(next(iter(_worlds)))
    _worlds[key] = world  # most recently used last
    return world


def forget_worlds() -> None:
    """Remove all worlds from this process's memory."""
    _worlds.clear()
