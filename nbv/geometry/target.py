"""Where the target stands, from points alone: the ground as a plane, and what rises from it near the aim.

What a vehicle must do that was told only roughly where its target is, or whose telemetry errs.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree

from nbv.random_streams import keyed_rng
from nbv.types import Floats

REACH_M = 4.0  # about the aim, horizontally: the seed orbit's radius
GROUND_BAND_M = 0.06  # to both sides of the plane: noise of sparse points, and a little relief
MAX_TILT_DEG = 20.0  # of the ground, with telemetry's error of attitude
LOWEST_PART_M = 0.15  # of what rises is left out: relief
MAX_BELOW = 0.1  # share of the points that may lie below the ground
VOXEL_M = 0.2  # points in neighbouring voxels are one thing
MIN_POINTS = 40  # of a thing
MIN_HALF_EXTENT_M, MAX_HALF_EXTENT_M = 0.2, 2.5
_TRIALS = 400
_COMPANION_M = 0.15  # a point farther from any other is taken for a wrong match


@dataclass(frozen=True)
class FoundTarget:
    """A thing that stands on the ground."""

    center_m: tuple[float, float, float]  # of its box, from the ground to its top
    half_extent_m: float  # of the box, along its longest axis


def find_target(points_m: Floats, aim_m: tuple[float, float, float] | Floats) -> FoundTarget | None:
    """The cluster of points (N, 3) above the ground whose centre is nearest to ``aim_m`` (3,); None where there is none.

    The ground is the near-horizontal plane with most points about it of all that have hardly any points below (RANSAC,
    Fischler and Bolles 1981). Clusters are connected voxels of what rises above it.
    """
    points, aim = np.asarray(points_m, dtype=float), np.asarray(aim_m, dtype=float)
    points = points[np.isfinite(points).all(axis=1)]
    points = points[np.linalg.norm(points[:, :2] - aim[:2], axis=1) <= REACH_M]
    if len(points) < MIN_POINTS:
        return None
    normal_offset = _ground(points)
    if normal_offset is None:
        return None
    normal, offset_m = normal_offset
    risen = points[points @ normal - offset_m > LOWEST_PART_M]
    if len(risen) < MIN_POINTS:
        return None
    risen = risen[cKDTree(risen).query(risen, k=3)[0][:, -1] <= _COMPANION_M]
    found = []
    for cluster in _clusters(risen):
        low, high = np.percentile(cluster, [0.5, 99.5], axis=0)
        center = (low + high) / 2
        ground_z_m = (offset_m - normal[:2] @ center[:2]) / normal[2]
        center[2] = (ground_z_m + high[2]) / 2
        half_m = max(float((high - low)[:2].max()) / 2, float(high[2] - ground_z_m) / 2)
        if MIN_HALF_EXTENT_M <= half_m <= MAX_HALF_EXTENT_M:
            x, y, z = (float(v) for v in center)
            found.append((float(np.linalg.norm(center - aim)), FoundTarget((x, y, z), half_m)))
    return min(found, key=lambda item: item[0])[1] if found else None


def _ground(points: Floats) -> tuple[Floats, float] | None:
    """Unit normal (3,) that points up, and offset, of the ground; None where no plane is like one."""
    rng = keyed_rng("target-ground", len(points))
    triples = points[rng.integers(len(points), size=(_TRIALS, 3))]
    normals = np.cross(triples[:, 1] - triples[:, 0], triples[:, 2] - triples[:, 0])
    lengths = np.linalg.norm(normals, axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        normals = normals / lengths[:, None]
    normals *= np.where(normals[:, 2] < 0, -1.0, 1.0)[:, None]
    level = (lengths > 1e-6) & (normals[:, 2] >= np.cos(np.deg2rad(MAX_TILT_DEG)))
    normals, anchors = normals[level], triples[level, 0]
    best, plane = 0, None
    for normal, anchor in zip(normals, anchors):
        height_m = (points - anchor) @ normal
        inliers = int(np.count_nonzero(np.abs(height_m) <= GROUND_BAND_M))
        if inliers > best and np.mean(height_m < -GROUND_BAND_M) <= MAX_BELOW:
            best, plane = inliers, (normal, float(normal @ anchor))
    if plane is None:
        return None
    flat = points[np.abs(points @ plane[0] - plane[1]) <= GROUND_BAND_M]
    normal = np.linalg.eigh(np.cov((flat - flat.mean(0)).T))[1][:, 0]
    normal = normal if normal[2] >= 0 else -normal
    if normal[2] < np.cos(np.deg2rad(MAX_TILT_DEG)):
        return plane
    return normal, float(normal @ flat.mean(0))


def _clusters(points: Floats) -> list[Floats]:
    """Connected components (26 neighbours) of the occupied voxels, as points (K, 3) each, of `MIN_POINTS` or more."""
    if len(points) < MIN_POINTS:
        return []
    cells = np.floor((points - points.min(axis=0)) / VOXEL_M).astype(np.int64)
    occupied = np.zeros(cells.max(axis=0) + 1, dtype=bool)
    occupied[tuple(cells.T)] = True
    labels, _ = ndimage.label(occupied, structure=np.ones((3, 3, 3)))
    owner = labels[tuple(cells.T)]
    counts = np.bincount(owner)
    return [points[owner == i] for i in np.flatnonzero(counts >= MIN_POINTS) if i > 0]
