"""Where the surface may be, from the sparse model: what depth estimation need not search."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from nbv.config import DenseConfig
from nbv.dense.stereo import SEARCH_MARGIN_M
from nbv.types import Floats

_COMPANIONS = 3
_FEWEST_POINTS = 100  # fewer say nothing about where the surface ends


def points_to_search(
    sparse_points_m: Floats, target_m: tuple[float, float, float] | Floats, config: DenseConfig
) -> Floats | None:
    """Points (M, 3) of the sparse model (N, 3) inside the crop around the target, wrong ones left out.

    A point without three others within `SEARCH_MARGIN_M` is taken for a wrong match: it would stretch what is
    searched. The tip of a thin rock has companions. ``None`` if fewer than 100 points are left.
    """
    points = np.asarray(sparse_points_m, dtype=float)
    points = points[
        np.abs(points - np.asarray(target_m, dtype=float)).max(axis=1, initial=0.0)
        <= config.crop_half_width_m
    ]
    if len(points) < _FEWEST_POINTS:
        return None
    nearest = cKDTree(points).query(points, k=_COMPANIONS + 1, distance_upper_bound=SEARCH_MARGIN_M)[0]
    points = points[np.isfinite(nearest[:, -1])]
    return points if len(points) >= _FEWEST_POINTS else None
