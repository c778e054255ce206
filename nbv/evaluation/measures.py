"""Numbers from nearest-neighbour distances: what the metrics are made of."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from nbv.types import Floats


def hausdorff_mm(to_cloud_m: Floats, to_gt_m: Floats) -> dict[str, float]:
    """Both directed Hausdorff distances and the symmetric one, from distances in metres, in mm."""
    forward, backward = (float((1000.0 * np.asarray(d)).max()) for d in (to_cloud_m, to_gt_m))
    return {
        "hausdorff_gt_to_cloud_mm": forward,
        "hausdorff_cloud_to_gt_mm": backward,
        "hausdorff_symmetric_mm": max(forward, backward),
    }


def f_score(precision: float, recall: float) -> float:
    """Harmonic mean of two percentages; 0 where both are 0."""
    return 0.0 if precision + recall == 0 else 2.0 * precision * recall / (precision + recall)


def area_under_curve(thresholds_mm: Sequence[float], scores: Sequence[float]) -> float:
    """Mean height of the piecewise-linear curve between the first and last threshold (0 to 100).

    With a single threshold, or several equal ones, the mean of the scores.
    """
    span = thresholds_mm[-1] - thresholds_mm[0]
    if span <= 0:
        return float(np.mean(scores))
    return float(np.trapezoid(scores, thresholds_mm) / span)


def sector_centers_deg(count: int) -> Floats:
    """(count,) azimuths of the sector centres, counter-clockwise from east; sector 0 starts at east."""
    return (np.arange(count) + 0.5) * 360.0 / count


def azimuth_sectors(
    points_m: Floats, target_m: tuple[float, float, float] | Floats, count: int
) -> NDArray[np.int64]:
    """(S,) sector index of each point (S, 3) about the vertical axis through the target."""
    azimuth_deg = np.rad2deg(np.arctan2(points_m[:, 1] - target_m[1], points_m[:, 0] - target_m[0])) % 360.0
    return np.minimum((azimuth_deg * count / 360.0).astype(np.int64), count - 1)


def sector_completeness(
    to_cloud_mm: Floats, sectors: NDArray[np.int64], count: int, threshold_mm: float
) -> list[float | None]:
    """Completeness in percent per sector; None where a sector holds no sample.

    Parameters
    ----------
    to_cloud_mm, sectors
        (S,) distance of each sample to the cloud, and its sector.
    count
        Number of sectors.
    threshold_mm
        A sample nearer than this is complete.
    """
    reached = to_cloud_mm < threshold_mm
    total = np.bincount(sectors, minlength=count)
    hit = np.bincount(sectors, weights=reached, minlength=count)
    return [100.0 * float(h) / int(n) if n else None for h, n in zip(hit, total)]
