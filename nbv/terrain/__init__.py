"""What the target lies on and among: relief, neighbouring rocks, and the part of the target that is above ground."""

from nbv.terrain.burial import buried_rock
from nbv.terrain.neighbours import (
    Body,
    Cylinder,
    Surroundings,
    joined_mesh,
    make_surroundings,
    neighbour_cylinders,
)
from nbv.terrain.relief import RELIEF_HALF_EXTENT_M, Relief, relief_of

__all__ = [
    "RELIEF_HALF_EXTENT_M",
    "Body",
    "Cylinder",
    "Relief",
    "Surroundings",
    "buried_rock",
    "joined_mesh",
    "make_surroundings",
    "neighbour_cylinders",
    "relief_of",
]
