"""Relief and neighbours of one target, as geometry."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from nbv.cache import Store
from nbv.config import GroundConfig, canonical
from nbv.terrain.neighbours import Body, neighbour_bodies, neighbour_cylinders
from nbv.terrain.relief import Relief, relief_of


@dataclass(frozen=True, eq=False)
class Surroundings:
    """What stands around the target; ``key`` is what it was made from, for addresses in a store."""

    relief: Relief | None
    neighbours: tuple[Body, ...]
    key: tuple[Any, ...]


def make_surroundings(
    ground: GroundConfig, ground_seed: int, rock_sha256: str, store: Store | None = None
) -> Surroundings | None:
    """The surroundings of the rock as it lies; None on bare flat ground."""
    if ground.relief_m == 0 and ground.neighbours == 0:
        return None
    cylinders = neighbour_cylinders(ground, ground_seed, rock_sha256)
    return Surroundings(
        relief_of(ground, ground_seed),
        neighbour_bodies(cylinders, ground_seed, rock_sha256, store),
        (canonical(ground), ground_seed, rock_sha256),
    )
