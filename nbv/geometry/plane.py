"""Planes through points, and the ground among them."""

from __future__ import annotations

from collections.abc import Callable
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


def ground_plane(
    points_m: Floats,
    drawn_from_m: Floats,
    band_m: float,
    is_ground: Callable[[Plane], bool],
    hypotheses: int,
    rng: np.random.Generator,
    most_below: float = 1.0,
) -> Plane | None:
    """The plane with most of the points (N, 3) within ``band_m`` of all that ``is_ground`` (RANSAC, Fischler and Bolles 1981).

    ``hypotheses`` planes are drawn through triples of ``drawn_from_m`` (M, 3); no more than ``most_below`` of the points may lie
    below one. The best is refined by least squares over the points about it, unless that is no ground. None where none is.
    """
    planes = [plane for plane in drawn_planes(drawn_from_m, hypotheses, rng) if is_ground(plane)]
    if not planes:
        return None
    # Single precision is enough to count (points lie within metres of the origin) and twice as fast; so are blocks that
    # stay in the processor's cache.
    normals = np.array([plane.normal for plane in planes], dtype=np.float32)
    offsets = np.array([[plane.offset_m] for plane in planes], dtype=np.float32)
    columns = np.ascontiguousarray(points_m.T, dtype=np.float32)
    near, below = np.zeros((2, len(planes)), dtype=np.int64)
    for start in range(0, len(points_m), 512):
        distance = normals @ columns[:, start : start + 512]
        distance -= offsets
        below += np.count_nonzero(distance < -band_m, axis=1)
        near += np.count_nonzero(np.abs(distance, out=distance) <= band_m, axis=1)
    near[below > most_below * len(points_m)] = 0
    best = int(near.argmax())
    if near[best] == 0:
        return None
    inliers = points_m[np.abs(planes[best].signed_distance_m(points_m)) <= band_m]
    refined = fitted_plane(inliers) if len(inliers) >= 3 else planes[best]
    return refined if is_ground(refined) else planes[best]


def drawn_planes(points_m: Floats, count: int, rng: np.random.Generator) -> list[Plane]:
    """The planes through ``count`` triples of the points (N, 3), without triples on a line."""
    triples = points_m[rng.integers(len(points_m), size=(count, 3))]
    normals = np.cross(triples[:, 1] - triples[:, 0], triples[:, 2] - triples[:, 0])
    lengths = np.linalg.norm(normals, axis=1)
    proper = lengths > 1e-9
    normals = normals[proper] / lengths[proper, None]
    normals *= np.where(normals[:, 2] < 0, -1.0, 1.0)[:, None]
    offsets_m = (normals * triples[proper, 0]).sum(1)
    return [Plane(normal, float(offset_m)) for normal, offset_m in zip(normals, offsets_m)]


def fitted_plane(points_m: Floats) -> Plane:
    """The total-least-squares plane of three points (N, 3) or more."""
    center = points_m.mean(0)
    normal = np.linalg.eigh(np.cov((points_m - center).T))[1][:, 0]
    normal = normal if normal[2] >= 0 else -normal
    return Plane(normal, float(normal @ center))
