"""From a recipe to a rock: signed distance on a grid near the surface, marching cubes, albedo."""

from __future__ import annotations

import numpy as np
from skimage.measure import marching_cubes

from nbv.cache import Arrays, Store, cached
from nbv.geometry.mesh import body_labels, drop_unused_vertices, face_areas, rest_on_ground, vertex_normals
from nbv.rocks.families import FAMILY_REGISTRY, generated_name, generated_recipe
from nbv.rocks.recipes import RECIPES
from nbv.rocks.rock import DEFAULT_HEIGHT_M, Rock, make_rock, rock_arrays, rock_of
from nbv.rocks.sdf import Recipe, Shape
from nbv.rocks.texture import procedural_albedo
from nbv.types import Floats, Floats32, Ints

GRID_M = 0.007  # of the signed distance; mean edge about 6 mm, below a pixel at 4 m (8.6 mm)
COARSE_GRID_M = 0.028  # where nothing is photographed: a sixteenth of the faces
LIPSCHITZ = 2.0  # how much faster than the true distance a shape function may change
_HALF_WIDTH_M, _TOP_M = 1.2, 1.92
_LEVELS = 3  # blocks of 8, 4, 2 cells
_PART = 16_384  # points


def generate_rock(name: str, store: Store | None = None, *, grid_m: float = GRID_M) -> Rock:
    """The procedural rock ``name``, of the catalogue or ``FAMILY-SEED``, from ``store`` if it is there: a pure function of name and grid.

    It takes a few seconds to make. ``KeyError`` where there is none.
    """
    drawn = generated_name(name)
    recipe = RECIPES[name] if drawn is None else generated_recipe(*drawn)
    inputs = [name, grid_m, *FAMILY_REGISTRY.sources(*(drawn or ())[:1])]

    def make() -> Arrays:
        # Recipes draw at the default height. Edges grow with the root of the rock's, faces with the rock's.
        vertices, faces = _surface(recipe, grid_m * float(np.sqrt(DEFAULT_HEIGHT_M / recipe.height_m)))
        vertices, _ = rest_on_ground(vertices, recipe.height_m)
        albedo = procedural_albedo(vertices, vertex_normals(vertices, faces), recipe.seed, recipe.paint)
        split, difficulty = recipe.split, recipe.difficulty
        return rock_arrays(make_rock(name, vertices, faces, albedo, split=split, difficulty=difficulty))

    return rock_of(cached(store, "rocks", make, code=__name__, inputs=inputs))


def _surface(recipe: Recipe, grid_m: float) -> tuple[Floats, Ints]:
    """The largest body of the recipe's zero level set."""
    distance, origin = sample_near_surface(recipe.shape, grid_m)
    vertices, faces, _, _ = marching_cubes(
        distance, 0.0, gradient_direction="descent", allow_degenerate=False
    )
    faces = faces.astype(np.int64)
    labels = body_labels(faces)
    areas = np.bincount(labels, weights=face_areas(vertices.astype(float), faces))
    vertices, faces = drop_unused_vertices(vertices.astype(float), faces[labels == np.argmax(areas)])
    return vertices * grid_m + origin, faces


def sample_near_surface(shape: Shape, grid_m: float) -> tuple[Floats32, Floats]:
    """Signed distances (X, Y, Z) on a grid, exact next to the surface and coarse elsewhere, and its first node (3,) in metres.

    Blocks of 8, then 4, then 2 cells are kept if the surface may pass through them, judged from the value at their centre and
    `LIPSCHITZ`; only the nodes of kept blocks of 2 cells are evaluated.
    """
    block = 2**_LEVELS * grid_m
    counts = np.ceil(np.array([2 * _HALF_WIDTH_M, 2 * _HALF_WIDTH_M, _TOP_M]) / block).astype(int)
    # One block below the ground, so that the flat base lies on a plane of nodes inside the grid.
    origin = np.array([-counts[0] * block / 2, -counts[1] * block / 2, -block])
    counts[2] += 1
    values = np.zeros(counts, dtype=np.float32)
    active = np.ones(counts, dtype=bool)
    size = block
    for level in range(_LEVELS):
        if level:
            size /= 2
            for axis in range(3):
                values, active = np.repeat(values, 2, axis), np.repeat(active, 2, axis)
        index = np.argwhere(active)
        distances = _by_parts(shape, origin + (index + 0.5) * size)
        values[active] = distances
        active[active] = np.abs(distances) <= LIPSCHITZ * size * np.sqrt(3) / 2
        if level == 0:  # the grid shrinks to the blocks around the surface
            low, high = index[active[tuple(index.T)]].min(0), index[active[tuple(index.T)]].max(0) + 1
            window = tuple(slice(a, b) for a, b in zip(low, high))
            values, active, origin = values[window], active[window], origin + low * size
    for axis in range(3):
        values = np.repeat(values, 2, axis)
    # A rim of nodes outside closes the surface; it lies next to blocks the surface cannot reach.
    distance = np.full(np.array(values.shape) + 3, 1.0, dtype=np.float32)
    distance[1:-2, 1:-2, 1:-2] = values
    nodes = np.zeros(distance.shape, dtype=bool)
    for dx in range(3):
        for dy in range(3):
            for dz in range(3):
                corner = tuple(slice(1 + d, 1 + d + 2 * n, 2) for d, n in zip((dx, dy, dz), active.shape))
                nodes[corner][active] = True
    origin = origin - grid_m
    distances = _by_parts(shape, origin + np.argwhere(nodes) * grid_m)
    # An exact zero would put several vertices on one node.
    distance[nodes] = np.where(np.abs(distances) < 1e-7, 1e-7, distances)
    return distance, origin


def _by_parts(shape: Shape, points_m: Floats) -> Floats32:
    """``shape`` at points (N, 3), so few at a time that they stay in the processor's cache."""
    parts = (points_m[at : at + _PART] for at in range(0, len(points_m), _PART))
    return np.concatenate([shape(part) for part in parts])
