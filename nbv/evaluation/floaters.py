"""Points that survive statistical outlier removal and yet lie away from the rock."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from nbv.evaluation.voxels import occupied_voxels
from nbv.types import Bools, Floats, Ints

FLATNESS = 8.0  # a loose neighbourhood is a surface where it is thinner than the radius over this
COARSE = 1.5  # of the median distance to the farthest neighbour: the radius is that at least
FAR_RADII = 4.0  # small clusters go where they are farther than so many radii from all others
CLUSTER_POINTS = 50  # voxels of 8 mm: 0.05 % of the surface of a rock of 1.6 m


def scattered_mask(points_m: Floats, distances_m: Floats, nearest: Ints, radius_m: float) -> Bools:
    """(N,) true where the neighbourhood is loose and no plane: wrong depths on which a few views agree by chance.

    Loose: the farthest of the k neighbours lies beyond ``radius_m``. No plane: point and neighbours deviate from their
    least-squares plane by more than ``radius_m / FLATNESS`` (root mean square). Density alone would cost completeness:
    a part of the rock that few views see is loose, too, but flat.

    Parameters
    ----------
    points_m
        (N, 3).
    distances_m, nearest
        (N, k): distances to, and indices of, the nearest others of each point, nearest first.
    """
    loose = np.flatnonzero(distances_m[:, -1] > radius_m)
    members = np.concatenate([points_m[loose, None], points_m[nearest[loose]]], axis=1)
    members -= members.mean(axis=1, keepdims=True)
    scatter = np.einsum("nki,nkj->nij", members, members) / members.shape[1]
    thickness_m = np.sqrt(np.maximum(np.linalg.eigvalsh(scatter)[:, 0], 0.0))
    scattered = np.zeros(len(points_m), dtype=bool)
    scattered[loose[thickness_m > radius_m / FLATNESS]] = True
    return scattered


def stray_mask(points_m: Floats, radius_m: float) -> Bools:
    """(N,) true in clusters of fewer than `CLUSTER_POINTS` points; what lies in touching cubes of ``radius_m`` is one.

    So a cluster goes only if it is both small and more than ``radius_m`` away from all others.
    """
    voxels = occupied_voxels(points_m, radius_m)
    pairs = cKDTree(voxels.cells).query_pairs(1.0, p=np.inf, output_type="ndarray")
    count = len(voxels.keys)
    touching = coo_array((np.ones(len(pairs), dtype=bool), tuple(pairs.T)), shape=(count, count))
    _, cluster_of_voxel = connected_components(touching, directed=False)
    cluster = cluster_of_voxel[voxels.voxel_of]
    stray: Bools = np.bincount(cluster)[cluster] < CLUSTER_POINTS
    return stray
