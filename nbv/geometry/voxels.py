"""Points by the voxel that they lie in."""

from __future__ import annotations

import numpy as np

from nbv.types import Floats, Floats32, Ints


def sums_by_voxel(keys: Ints, values: Floats | Floats32) -> tuple[Floats, Ints]:
    """(V, K) sums of the values (N, K) of the points in each occupied voxel, by ascending key (N,), and (V,) how many they are."""
    order = np.argsort(keys, kind="stable")
    starts = np.flatnonzero(np.diff(keys[order], prepend=-1))
    sums = np.add.reduceat(values.take(order, axis=0).astype(np.float64), starts, axis=0)
    return sums, np.diff(np.append(starts, len(order)))
