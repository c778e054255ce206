"""Distances to nearest neighbours within one small cloud, worked out once per cloud.

Stopping rule, gate features and B-aware's local sparsity ask the same question of the same points in one
iteration. The memory is keyed by the points themselves, so it is invisible except in time.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy.spatial import cKDTree

from nbv.types import Floats


def neighbour_distances(points_m: Floats, k: int) -> Floats:
    """(N, k) distances from each of the N > k points to its ``k`` nearest others, nearest first (read-only)."""
    points = np.ascontiguousarray(points_m, dtype=np.float64)
    return _distances(points.tobytes(), len(points), k)


@lru_cache(maxsize=4)
def _distances(data: bytes, n: int, k: int) -> Floats:
    points = np.frombuffer(data).reshape(n, -1)
    tree = cKDTree(points, balanced_tree=False)
    found = np.empty((n, k + 1))
    order = tree.indices  # a tenth faster than the points' own order
    found[order] = tree.query(points[order], k=k + 1)[0]
    distances: Floats = found[:, 1:]  # the nearest is the point itself, at 0
    distances.setflags(write=False)
    return distances
