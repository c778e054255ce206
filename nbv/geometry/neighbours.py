"""Distances to nearest neighbours: any two clouds, and one small cloud within itself, worked out once.

Queries are visited in an order in which neighbours follow each other, so that the branches of the tree that one query needs
are still in the processor's cache for the next. One thread, as everything in a mission.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy.spatial import cKDTree

from nbv.config import MissionConfig
from nbv.types import Floats, Ints

_LEAF = 32  # points in a leaf of a tree
_LEAF_FOR_ONE = 128  # where one neighbour is asked for: half the time of 32 for a cloud half a metre off


def nearest_neighbours(points_m: Floats, queries_m: Floats, k: int = 1) -> tuple[Floats, Ints]:
    """Distances to, and indices of, the ``k`` nearest of points (N, 3), N >= ``k``, for each query (Q, 3): (Q, k) each, nearest first.

    (Q,) for ``k = 1``. Several times faster than a plain query on large clouds.
    """
    tree = cKDTree(points_m, leafsize=_LEAF if k > 1 else _LEAF_FOR_ONE)
    if queries_m is points_m:
        order = tree.indices
    else:
        order = cKDTree(queries_m, leafsize=_LEAF, balanced_tree=False, compact_nodes=False).indices
    sorted_distances, sorted_indices = tree.query(queries_m[order], k=k, workers=1)
    distances, indices = np.empty_like(sorted_distances), np.empty_like(sorted_indices)
    distances[order], indices[order] = sorted_distances, sorted_indices
    return distances, indices


def without_isolated(points_m: Floats, within_m: float) -> Floats:
    """Of points (N, 3) those with two others within ``within_m``; all of fewer than three."""
    if len(points_m) < 3:
        return points_m
    return np.asarray(points_m[cKDTree(points_m).query(points_m, k=3)[0][:, -1] <= within_m])


def neighbour_distances(points_m: Floats, k: int) -> Floats:
    """(N, k) distances from each of the N > k points to its ``k`` nearest others, nearest first (read-only).

    Stopping rule, gate features and B-aware's local sparsity ask the same question of the same points in one
    iteration. The memory is keyed by the points themselves, so it is invisible except in time.
    """
    points = np.ascontiguousarray(points_m, dtype=np.float64)
    return _distances(points.tobytes(), len(points), k)


@lru_cache(maxsize=4)
def _distances(data: bytes, n: int, k: int) -> Floats:
    points = np.frombuffer(data).reshape(n, -1)
    distances = nearest_neighbours(points, points, k + 1)[0][:, 1:]  # the nearest is the point itself, at 0
    distances.setflags(write=False)
    return distances


def knn_d95_m(points_m: Floats, config: MissionConfig) -> float:
    """Eq. 9's statistic: of points (N, 3), the 95th percentile (m) of the distance to the k-th neighbour, itself excluded.

    ``stop`` says which neighbour, and whether only points in the paper's box (section III-A) count. Fewer than k + 1 points
    give infinity: such a cloud has certainly not converged.
    """
    k, points = config.stop.knn_neighbours, np.asarray(points_m, dtype=float).reshape(-1, 3)
    if config.stop.knn_region == "box":
        offset_m = np.abs(points - np.asarray(config.target_m))
        points = points[(offset_m <= config.shared.box_half_extent_m).all(axis=1)]
    if len(points) < k + 1:
        return np.inf
    return float(np.percentile(neighbour_distances(points, k)[:, -1], 95))
