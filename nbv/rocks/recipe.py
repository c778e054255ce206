"""What recipes of procedural rocks are made of: the recipe itself, relief, bending, facets and the ground cut."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from nbv.rocks import sdf
from nbv.rocks.albedo import Paint
from nbv.rocks.noise import octaves
from nbv.rocks.rock import DEFAULT_HEIGHT_M, Split
from nbv.types import Floats

Shape = Callable[[Floats], Floats]  # (N, 3) points in metres -> (N,) signed distance, negative inside


@dataclass(frozen=True)
class Recipe:
    """One procedural rock."""

    split: Split
    seed: int  # of relief, facets and albedo
    difficulty: str  # what makes it easy or hard, in a phrase
    shape: Shape
    paint: Paint
    height_m: float = DEFAULT_HEIGHT_M


def rough(points: Floats, seed: int, scale: float = 1.0) -> Floats:
    """Surface relief of five octaves, 0.6 m down to 4 cm."""
    relief = octaves(points, (0.62, 0.31, 0.155, 0.078, 0.039), (0.034, 0.020, 0.011, 0.0055, 0.0028), seed)
    return scale * relief.astype(np.float64)


def warp(points: Floats, seed: int, amplitude: float, wavelength: float) -> Floats:
    """Points (N, 3) moved by a smooth random field, which bends whatever is evaluated at them; amplitude and wavelength in metres."""
    moved = [octaves(points, (wavelength,), (amplitude,), seed * 7 + axis) for axis in range(3)]
    return points + np.stack(moved, axis=1)


def facets(points: Floats, seed: int, count: int, center: tuple[float, float, float], reach: float) -> Floats:
    """A random convex polyhedron at points (N, 3): ``count`` planes at 0.85 to 1.1 times ``reach`` from ``center``, in metres."""
    rng = np.random.default_rng(seed)
    local = points - np.asarray(center)
    distance = np.full(len(points), -np.inf)
    for _ in range(count):
        normal = rng.normal(size=3)
        distance = np.maximum(distance, sdf.half_space(local, normal, reach * rng.uniform(0.85, 1.1)))
    return distance


def grounded(points: Floats, distance: Floats) -> Floats:
    """Cut flat at the ground."""
    return np.maximum(distance, -points[:, 2])
