"""Points averaged in the voxels of a grid."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nbv.types import Floats, Ints

_BITS = 21  # of a key for each index: a million voxels either way from the origin


@dataclass(frozen=True)
class Voxels:
    """The V occupied voxels of N points, in lexicographic order."""

    keys: Ints  # (V,) ascending; equal keys are equal voxels, whatever the points
    means_m: Floats  # (V, 3) of the points in each
    voxel_of: Ints  # (N,) each point's, as a row of the others

    @property
    def cells(self) -> Ints:
        """(V, 3) indices; neighbours differ by 1."""
        shifts = np.arange(2, -1, -1) * _BITS
        return (self.keys[:, None] >> shifts & (1 << _BITS) - 1) - (1 << _BITS - 1)


def occupied_voxels(points_m: Floats, voxel_m: float) -> Voxels:
    """The voxels of size ``voxel_m``, the origin a corner of one, that hold a point (N, 3)."""
    x, y, z = np.floor(points_m / voxel_m).astype(np.int64).T + (1 << _BITS - 1)
    keys, voxel_of, counts = np.unique(
        x << 2 * _BITS | y << _BITS | z, return_inverse=True, return_counts=True
    )
    sums = np.stack([np.bincount(voxel_of, weights=points_m[:, k]) for k in range(3)], axis=1)
    return Voxels(keys, sums / counts[:, None], voxel_of)
