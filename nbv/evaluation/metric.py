"""What a metric is, what it is measured from, and the arithmetic that metrics share."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nbv.config import EvaluationConfig
from nbv.types import Floats


@dataclass(frozen=True)
class Distances:
    """What a cloud's metrics on one surface are made from: S reference samples, N reconstructed points."""

    to_cloud_mm: Floats  # (S,) from each sample to the cloud: what is missing
    to_truth_mm: Floats  # (N,) from each point to the whole reference surface: what is wrong
    sectors: NDArray[np.int64]  # (S,) azimuth sector of each sample
    config: EvaluationConfig


@dataclass(frozen=True)
class Metric:
    """One number of a mission's result, or one for each of ``evaluation.thresholds_mm``."""

    key: str  # its name in the result; ``{t}`` stands for the threshold in mm
    label: str  # its name for people; may hold ``{t}``, too
    unit: str  # "%", "mm"
    larger_is_better: bool
    measure: Callable[
        [Distances, float], Any
    ]  # from the distances and the threshold in mm (0: the key has none)


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


def share_by_sector(sectors: NDArray[np.int64], share: Floats, count: int) -> list[float | None]:
    """Mean in percent of the samples' shares (S,) in each of ``count`` sectors (S,); None where a sector holds none."""
    total = np.bincount(sectors, minlength=count)
    hit = np.bincount(sectors, weights=share, minlength=count)
    return [100.0 * float(h) / int(n) if n else None for h, n in zip(hit, total)]
