"""What recipes of procedural rocks are made of: signed distance functions, relief, bending, facets, the ground cut, the recipe itself.

Distances are negative inside, in metres. Points are (N, 3), results (N,).
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from nbv.rocks.rock import DEFAULT_HEIGHT_M, Split
from nbv.rocks.texture import Paint, octaves
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


def rotation(yaw_deg: float = 0.0, pitch_deg: float = 0.0, roll_deg: float = 0.0) -> Floats:
    """(3, 3) rotation: about x by roll, then y by pitch, then z by yaw."""
    turned = scipy.spatial.transform.Rotation.from_euler("xyz", [roll_deg, pitch_deg, yaw_deg], degrees=True)
    return np.asarray(turned.as_matrix())


def _about(points: Floats, center: Sequence[float] | Floats, turn: Floats | None) -> Floats:
    local = points - np.asarray(center)
    return local if turn is None else local @ turn


def ellipsoid(
    points: Floats,
    center: Sequence[float] | Floats,
    radii: Sequence[float] | Floats,
    turn: Floats | None = None,
) -> Floats:
    """An ellipsoid turned by ``turn`` (3, 3) about its centre; the distance is first-order, exact at the surface."""
    local = _about(points, center, turn)
    scaled = local / np.asarray(radii)
    k0 = np.linalg.norm(scaled, axis=1)
    k1 = np.linalg.norm(scaled / np.asarray(radii), axis=1)
    return np.where(k1 > 1e-12, k0 * (k0 - 1.0) / np.maximum(k1, 1e-12), -min(radii))


def box(
    points: Floats,
    center: Sequence[float] | Floats,
    half_sizes: Sequence[float] | Floats,
    round_m: float = 0.0,
    turn: Floats | None = None,
) -> Floats:
    """A box, turned by ``turn`` (3, 3) about its centre, whose edges are rounded by ``round_m``."""
    local = _about(points, center, turn)
    q = np.abs(local) - (np.asarray(half_sizes) - round_m)
    return np.linalg.norm(np.maximum(q, 0), axis=1) + np.minimum(q.max(1), 0) - round_m


def capsule(
    points: Floats, start: Sequence[float] | Floats, end: Sequence[float] | Floats, radius: float
) -> Floats:
    """A cylinder with round ends, whose middles are ``start`` and ``end``."""
    a, b = np.asarray(start), np.asarray(end)
    t = np.clip((points - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1)
    return np.linalg.norm(points - a - t[:, None] * (b - a), axis=1) - radius


def half_space(points: Floats, normal: Sequence[float] | Floats, offset: float) -> Floats:
    """The side of a plane that ``normal`` points away from."""
    n = np.asarray(normal) / np.linalg.norm(normal)
    return points @ n - offset


def union(a: Floats, b: Floats, smooth_m: float) -> Floats:
    """The union of two bodies, blended over ``smooth_m`` (polynomial smooth minimum, after Quilez)."""
    h = np.maximum(smooth_m - np.abs(a - b), 0) / smooth_m
    return np.minimum(a, b) - h * h * smooth_m / 4


def union_of(parts: Iterable[Floats]) -> Floats:
    """The union of all parts, in order, each blended into the ones before it over 5 cm."""
    return functools.reduce(lambda whole, part: union(whole, part, 0.05), parts)


def intersection(a: Floats, b: Floats, smooth_m: float) -> Floats:
    """Smooth intersection."""
    return -union(-a, -b, smooth_m)


def subtract(a: Floats, b: Floats, smooth_m: float) -> Floats:
    """Smooth ``a`` without ``b``."""
    return intersection(a, -b, smooth_m)


def spheres(points: Floats, centers: Floats, radii: Floats) -> Floats:
    """The union of many spheres (M, 3), (M,), by the sphere of least power at each point.

    |p - c|^2 - r^2 is least for the nearest neighbour of (p, 0) among (c, sqrt(r_max^2 - r^2)).
    """
    lifted = np.column_stack([centers, np.sqrt(radii.max() ** 2 - radii**2)])
    tree = scipy.spatial.cKDTree(lifted)
    _, nearest = tree.query(np.column_stack([points, np.zeros(len(points))]))
    return np.linalg.norm(points - centers[nearest], axis=1) - radii[nearest]


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
        distance = np.maximum(distance, half_space(local, normal, reach * rng.uniform(0.85, 1.1)))
    return distance


def grounded(points: Floats, distance: Floats) -> Floats:
    """Cut flat at the ground."""
    return np.maximum(distance, -points[:, 2])
