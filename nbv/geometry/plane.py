"""Planes through points: hypotheses from triples, and the least-squares plane of the points that agree with one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nbv.types import Floats


@dataclass(frozen=True)
class Plane:
    """``normal . x = offset_m`` with a unit normal that points up."""

    normal: Floats  # (3,)
    offset_m: float

    def signed_distance_m(self, points_m: Floats) -> Floats:
        """(N,) distances of points (N, 3), positive above the plane."""
        return points_m @ self.normal - self.offset_m

    def height_at_m(self, x_m: float, y_m: float) -> float:
        """z of the plane at (x, y)."""
        return float((self.offset_m - self.normal[0] * x_m - self.normal[1] * y_m) / self.normal[2])


def drawn_planes(points_m: Floats, count: int, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Upward unit normals (K, 3) and a point (K, 3) of the planes through ``count`` triples of the points (N, 3), K of them proper."""
    triples = points_m[rng.integers(len(points_m), size=(count, 3))]
    normals = np.cross(triples[:, 1] - triples[:, 0], triples[:, 2] - triples[:, 0])
    lengths = np.linalg.norm(normals, axis=1)
    proper = lengths > 1e-9
    normals = normals[proper] / lengths[proper, None]
    normals *= np.where(normals[:, 2] < 0, -1.0, 1.0)[:, None]
    return normals, triples[proper, 0]


def fitted_plane(points_m: Floats) -> Plane:
    """The total-least-squares plane of three points (N, 3) or more."""
    center = points_m.mean(0)
    normal = np.linalg.eigh(np.cov((points_m - center).T))[1][:, 0]
    normal = normal if normal[2] >= 0 else -normal
    return Plane(normal, float(normal @ center))
