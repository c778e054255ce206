"""Other rocks about the target: where they stand, and what they look like."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from nbv.cache import Store
from nbv.config import GroundConfig, canonical
from nbv.errors import UserError
from nbv.geometry.mesh import vertex_normals
from nbv.random_streams import keyed_rng
from nbv.rocks import Rock
from nbv.rocks.albedo import procedural_albedo
from nbv.rocks.procedural import generate_rock
from nbv.rocks.recipes import RECIPES
from nbv.terrain.relief import Relief, relief_of
from nbv.types import Floats, Floats32, Ints

CROP_M = 1.5  # half the side of the square that evaluation crops to by default
APART_M = 0.2  # between two neighbours
SHAPES = ("boulder", "slab", "waist", "breccia")  # training rocks; quick to make
GRID_M = 0.025  # of a shape before it is scaled down: edges of 1 to 2 cm
_TRIES = 400


@dataclass(frozen=True)
class Cylinder:
    """An upright cylinder that holds one neighbour: its place in the world."""

    center_m: tuple[float, float]
    radius_m: float
    base_m: float
    top_m: float


@dataclass(frozen=True, eq=False)
class Body:
    """A mesh with an albedo per vertex."""

    vertices_m: Floats  # (V, 3)
    faces: Ints  # (F, 3)
    albedo: Floats32  # (V, 3)


@lru_cache(maxsize=64)
def neighbour_cylinders(ground: GroundConfig, ground_seed: int, rock_sha256: str) -> tuple[Cylinder, ...]:
    """Where the neighbours of one rock stand: the same in every mission.

    Each is outside of the evaluation's crop by a gap within ``neighbour_gap_m``, and clear of the others.

    `UserError` where there is no room for so many.
    """
    relief = relief_of(ground, ground_seed)
    rng = keyed_rng("neighbours", ground_seed, rock_sha256)
    cylinders: list[Cylinder] = []
    for _ in range(_TRIES):
        if len(cylinders) == ground.neighbours:
            break
        height_m = rng.uniform(*ground.neighbour_height_m)
        radius_m = height_m * rng.uniform(0.4, 0.7)
        outward = np.array([np.cos(bearing := rng.uniform(0, 2 * np.pi)), np.sin(bearing)])
        away_m = (CROP_M + rng.uniform(*ground.neighbour_gap_m) + radius_m) / np.abs(outward).max()
        center = away_m * outward
        if all(
            np.hypot(*(center - other.center_m)) > radius_m + other.radius_m + APART_M for other in cylinders
        ):
            base_m = 0.0 if relief is None else _lowest(relief, center, radius_m)
            cylinders.append(
                Cylinder((float(center[0]), float(center[1])), radius_m, base_m, base_m + height_m)
            )
    if len(cylinders) < ground.neighbours:
        raise UserError(
            f"there is room for {len(cylinders)} of ground.neighbours {ground.neighbours}; ask for fewer, or a wider "
            "ground.neighbour_gap_m"
        )
    return tuple(cylinders)


def _bodies(
    cylinders: tuple[Cylinder, ...], ground_seed: int, rock_sha256: str, store: Store | None
) -> tuple[Body, ...]:
    """The neighbours' meshes: training rocks turned and scaled into their cylinders, each with a texture of its own seed."""
    rng = keyed_rng("neighbour shapes", ground_seed, rock_sha256)
    bodies = []
    for cylinder in cylinders:
        name, turn, seed = SHAPES[rng.integers(len(SHAPES))], rng.uniform(0, 2 * np.pi), rng.integers(2**31)
        shape = generate_rock(name, store, grid_m=GRID_M)
        vertices, faces = shape.vertices_m.copy(), shape.faces
        vertices[:, :2] @= np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
        across = cylinder.radius_m / np.linalg.norm(vertices[:, :2], axis=1).max()
        up = (cylinder.top_m - cylinder.base_m) / vertices[:, 2].max()
        vertices *= [across, across, up]
        # Painted at its own size, so that its grains are as large as the target's.
        albedo = procedural_albedo(vertices, vertex_normals(vertices, faces), int(seed), RECIPES[name].paint)
        bodies.append(Body(vertices + np.array([*cylinder.center_m, cylinder.base_m]), faces, albedo))
    return tuple(bodies)


@dataclass(frozen=True, eq=False)
class Surroundings:
    """What stands around the target; ``key`` is what it was made from, for keys of a store."""

    relief: Relief | None
    neighbours: tuple[Body, ...]
    key: tuple[Any, ...]


def make_surroundings(
    ground: GroundConfig, ground_seed: int, rock_sha256: str, store: Store | None = None
) -> Surroundings | None:
    """The surroundings of the rock as it lies; None on bare flat ground.

    ``ground_seed`` and ``rock_sha256`` are the key of the draws; ``store`` keeps shapes.
    """
    if ground.relief_m == 0 and ground.neighbours == 0:
        return None
    cylinders = neighbour_cylinders(ground, ground_seed, rock_sha256)
    return Surroundings(
        relief_of(ground, ground_seed),
        _bodies(cylinders, ground_seed, rock_sha256, store),
        (canonical(ground), ground_seed, rock_sha256),
    )


def joined_mesh(rock: Rock, around: Surroundings | None) -> tuple[Body, tuple[int, ...]]:
    """All that stands on the ground as one mesh, the rock first, and where the vertices of each part end."""
    parts: list[Rock | Body] = [rock, *(() if around is None else around.neighbours)]
    ends = tuple(np.cumsum([len(part.vertices_m) for part in parts]).tolist())
    faces = [part.faces + first for part, first in zip(parts, (0, *ends))]
    vertices, albedo = ([getattr(part, name) for part in parts] for name in ("vertices_m", "albedo"))
    return Body(np.concatenate(vertices), np.concatenate(faces), np.concatenate(albedo)), ends


def _lowest(relief: Relief, center: Floats, radius_m: float) -> float:
    angle = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    rim = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return float(relief.height_m(center + radius_m * np.concatenate([rim, 0.5 * rim, [[0.0, 0.0]]])).min())
