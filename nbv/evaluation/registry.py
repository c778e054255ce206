"""Distances between a cleaned cloud and the reference surface, and the metrics made from them.

Directions. ``gt -> cloud`` runs from each reference sample to its nearest reconstructed point: it
measures what is missing (completeness, recall). ``cloud -> gt`` runs from each reconstructed point to
its nearest reference sample: it measures what is wrong (accuracy, precision). The paper's C2C family and
its Hausdorff distance are ``gt -> cloud``.

Surfaces. ``whole`` is the complete reference surface, underside included, as in the paper. ``observable``
keeps the samples that at least two reachable cameras can see. ``cloud -> gt`` distances run to the whole
surface in both: a point reconstructed on a hardly observable facet is right, not wrong.

Thresholds are strict, as in Tanks and Temples (Knapitsch et al. 2017, Eq. 4 to 8): a distance counts when it is less than t.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nbv.config import EvaluationConfig
from nbv.errors import MissionFailure
from nbv.evaluation.ground_truth import GroundTruthSamples
from nbv.geometry.visibility import nearest_neighbours
from nbv.plugins import Registry, leave_out
from nbv.types import Floats, PointCloud

# What a metric is, what it is measured from, and the arithmetic that metrics share.


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
    # From the distances and the threshold in mm (0: the key has none).
    measure: Callable[[Distances, float], Any]


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


SECTOR_THRESHOLD_MM = 48.0  # 3 % of the rock's height: the paper's Fig. 3


def completeness(distances: Distances, threshold_mm: float) -> float:
    """Percentage of the samples that lie less than the threshold from the cloud (recall)."""
    return 100.0 * float((distances.to_cloud_mm < threshold_mm).mean())


def accuracy(distances: Distances, threshold_mm: float) -> float:
    """Percentage of the points that lie less than the threshold from the truth (precision)."""
    return 100.0 * float((distances.to_truth_mm < threshold_mm).mean())


def f_score_at(distances: Distances, threshold_mm: float) -> float:
    """Harmonic mean of the two."""
    return f_score(accuracy(distances, threshold_mm), completeness(distances, threshold_mm))


def _auc(distances: Distances, _: float) -> float:
    thresholds_mm = sorted(distances.config.thresholds_mm)
    return area_under_curve(thresholds_mm, [f_score_at(distances, t) for t in thresholds_mm])


def _by_sector(distances: Distances, _: float) -> list[float | None]:
    reached = (distances.to_cloud_mm < SECTOR_THRESHOLD_MM).astype(float)
    return share_by_sector(distances.sectors, reached, distances.config.azimuth_sectors)


def _distance(key: str, label: str, statistic: Callable[[Floats], Any], surfaces: str = "missing") -> Metric:
    """A metric in mm: a statistic of what is missing, of what is wrong, or the larger of both."""
    sides = {
        "missing": lambda d: (d.to_cloud_mm,),
        "wrong": lambda d: (d.to_truth_mm,),
        "both": lambda d: (d.to_cloud_mm, d.to_truth_mm),
    }[surfaces]
    return Metric(key, label, "mm", False, lambda d, _: max(float(statistic(side)) for side in sides(d)))


_p95 = partial(np.percentile, q=95)
METRICS: dict[str, Metric] = {
    metric.key: metric
    for metric in (
        _distance("hausdorff_gt_to_cloud_mm", "Hausdorff distance", np.max),
        _distance("hausdorff_cloud_to_gt_mm", "Hausdorff distance, cloud to truth", np.max, "wrong"),
        _distance("hausdorff_symmetric_mm", "Symmetric Hausdorff distance", np.max, "both"),
        _distance("c2c_mean_mm", "Mean C2C distance", np.mean),
        _distance("c2c_median_mm", "Median C2C distance", np.median),
        _distance("c2c_p95_mm", "P95 C2C distance", _p95),
        _distance("c2c_cloud_to_gt_mean_mm", "Mean C2C distance, cloud to truth", np.mean, "wrong"),
        _distance("c2c_cloud_to_gt_median_mm", "Median C2C distance, cloud to truth", np.median, "wrong"),
        _distance("c2c_cloud_to_gt_p95_mm", "P95 C2C distance, cloud to truth", _p95, "wrong"),
        Metric("completeness_{t}mm", "Completeness @ {t} mm", "%", True, completeness),
        Metric("accuracy_{t}mm", "Accuracy @ {t} mm", "%", True, accuracy),
        Metric("f_score_{t}mm", "F-score @ {t} mm", "%", True, f_score_at),
        Metric("f_score_auc", "F-score, mean over thresholds", "%", True, _auc),
        Metric(
            f"sector_completeness_{SECTOR_THRESHOLD_MM:g}mm",
            f"Completeness @ {SECTOR_THRESHOLD_MM:g} mm by sector",
            "%",
            True,
            _by_sector,
        ),
    )
}
METRIC_REGISTRY = Registry("metrics", METRICS)
# What geometric missions predict of them (`nbv.geometric.completeness`); the others need a cloud.
PREDICTED = ("completeness_{t}mm", "f_score_{t}mm", "f_score_auc")


def all_metrics() -> dict[str, Metric]:
    """Those built in, then those of plug-ins."""
    of_plugins = {plugin.loaded.key: plugin for plugin in METRIC_REGISTRY.plugins().values()}
    for taken in METRICS.keys() & of_plugins.keys():
        leave_out(of_plugins.pop(taken))
    return {**METRICS, **{key: plugin.loaded for key, plugin in of_plugins.items()}}


def measure_all(distances: Distances) -> dict[str, Any]:
    """Every metric's value by its name in ``mission.json``, with the threshold in mm where it has one (``f_score_48mm``)."""
    values = {}
    for metric in all_metrics().values():
        thresholds_mm = sorted(distances.config.thresholds_mm) if "{t}" in metric.key else [0.0]
        for t in thresholds_mm:
            values[metric.key.replace("{t}", f"{t:g}")] = metric.measure(distances, t)
    return values


def find_metric(key: str) -> tuple[Metric, str] | None:
    """The metric that the name ``key`` of a result stands for, and its label; ``None`` for other facts."""
    for metric in all_metrics().values():
        pattern = re.escape(metric.key).replace(re.escape("{t}"), r"(?P<t>\d+(?:\.\d+)?)")
        if match := re.fullmatch(pattern, key):
            return metric, metric.label.replace("{t}", match.groupdict().get("t", ""))
    return None


def compute_metrics(
    cloud: PointCloud,
    truth: GroundTruthSamples,
    config: EvaluationConfig,
    target_m: tuple[float, float, float] | Floats,
    to_gt_m: Floats,
) -> dict[str, Any]:
    """Score a cleaned cloud against the reference: after the ground-truth gate, if ``gt_gate_m`` turns it on.

    ``target_m`` is the axis of the azimuth sectors, ``to_gt_m`` (N,) how far the cloud's points are from the reference surface.
    `MissionFailure` ``empty_cloud``: no point, or none within the configured gate. `ValueError` where no sample is observable.
    """
    points, to_gt = np.asarray(cloud.points_m, dtype=float), to_gt_m
    if not truth.observable.any():
        raise ValueError("no ground-truth sample is observable; check the camera shell")
    if config.gt_gate_m > 0:
        points, to_gt = points[to_gt <= config.gt_gate_m], to_gt[to_gt <= config.gt_gate_m]
    if len(points) == 0:
        gate = f" within the {1000 * config.gt_gate_m:.0f} mm ground-truth gate" if config.gt_gate_m else ""
        raise MissionFailure("empty_cloud", f"no reconstructed point is left to score{gate}")
    to_cloud, _ = nearest_neighbours(points, truth.points_m)
    sectors = azimuth_sectors(truth.points_m, target_m, config.azimuth_sectors)
    metrics: dict[str, Any] = {
        "n_points": len(points),
        "gt_gate_m": config.gt_gate_m,
        "sector_centers_deg": sector_centers_deg(config.azimuth_sectors).tolist(),
    }
    for name, mask in (("whole", np.ones(len(to_cloud), dtype=bool)), ("observable", truth.observable)):
        distances = Distances(1000.0 * to_cloud[mask], 1000.0 * to_gt, sectors[mask], config)
        metrics[name] = {**measure_all(distances), "n_gt_samples": int(mask.sum())}
    return metrics
