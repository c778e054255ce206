"""Spacing of the sparse cloud: the statistic behind Eq. 9's gate and the stopping rule."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from nbv.geometry.neighbours import neighbour_distances
from nbv.types import Floats


@dataclass(frozen=True)
class KnnStatistics:
    """Distance (m) to the k-th nearest neighbour over a cloud; infinite when there are too few points."""

    mean_m: float
    d95_m: float  # 95th percentile


def knn_statistics(
    points_m: Floats,
    k: int = 5,
    region: Literal["all", "box"] = "all",
    target_m: tuple[float, float, float] = (0.0, 0.0, 0.8),
    box_half_extent_m: float = 2.0,
) -> KnnStatistics:
    """Mean and 95th percentile of the distance to the ``k``-th neighbour, the point itself excluded.

    ``points_m`` is (N, 3) in the aligned world frame, so the result is in metres. ``region="box"`` keeps
    only the points within ``box_half_extent_m`` of ``target_m`` along each axis (the paper's Section
    III-A box). Fewer than ``k + 1`` points give infinity: such a cloud has certainly not converged.
    """
    points = np.asarray(points_m, dtype=float).reshape(-1, 3)
    if region == "box":
        points = points[(np.abs(points - np.asarray(target_m)) <= box_half_extent_m).all(axis=1)]
    if len(points) < k + 1:
        return KnnStatistics(np.inf, np.inf)
    distances = neighbour_distances(points, k)[:, -1]
    return KnnStatistics(float(distances.mean()), float(np.percentile(distances, 95)))
