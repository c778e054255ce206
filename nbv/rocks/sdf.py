"""Signed distance functions: negative inside, metres. Points are (N, 3), results (N,)."""

from __future__ import annotations

import functools
from collections.abc import Iterable, Sequence

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from nbv.types import Floats


def rotation(yaw_deg: float = 0.0, pitch_deg: float = 0.0, roll_deg: float = 0.0) -> Floats:
    """(3, 3) rotation: about x by roll, then y by pitch, then z by yaw."""
    return np.asarray(Rotation.from_euler("xyz", [roll_deg, pitch_deg, yaw_deg], degrees=True).as_matrix())


def _about(points: Floats, center: Sequence[float] | Floats, turn: Floats | None) -> Floats:
    local = points - np.asarray(center)
    return local if turn is None else local @ turn


def ellipsoid(
    points: Floats, center: Sequence[float], radii: Sequence[float], turn: Floats | None = None
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


def capsule(points: Floats, start: Sequence[float], end: Sequence[float], radius: float) -> Floats:
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
    tree = cKDTree(lifted)
    _, nearest = tree.query(np.column_stack([points, np.zeros(len(points))]))
    return np.linalg.norm(points - centers[nearest], axis=1) - radii[nearest]
