"""The metrics of a cloud: built in are `METRICS`, with those of plug-ins `all_metrics`.

Reports read names, units and directions from here; missions hold every metric for the whole and the observable surface.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import numpy as np

from nbv.evaluation.metric import Distances, Metric, area_under_curve, f_score, share_by_sector
from nbv.plugins import Registry, leave_out
from nbv.types import Floats

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


def _p95(distances: Floats) -> Any:
    return np.percentile(distances, 95)


def _distance(key: str, label: str, statistic: Callable[[Floats], Any], surfaces: str = "missing") -> Metric:
    """A metric in mm: a statistic of what is missing, of what is wrong, or the larger of both."""
    sides = {
        "missing": lambda d: (d.to_cloud_mm,),
        "wrong": lambda d: (d.to_truth_mm,),
        "both": lambda d: (d.to_cloud_mm, d.to_truth_mm),
    }[surfaces]
    return Metric(key, label, "mm", False, lambda d, _: max(float(statistic(side)) for side in sides(d)))


def _percentage(key: str, label: str, measure: Callable[[Distances, float], Any]) -> Metric:
    return Metric(key, label, "%", True, measure)


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
        _percentage("completeness_{t}mm", "Completeness @ {t} mm", completeness),
        _percentage("accuracy_{t}mm", "Accuracy @ {t} mm", accuracy),
        _percentage("f_score_{t}mm", "F-score @ {t} mm", f_score_at),
        _percentage("f_score_auc", "F-score, mean over thresholds", _auc),
        _percentage(
            f"sector_completeness_{SECTOR_THRESHOLD_MM:g}mm",
            f"Completeness @ {SECTOR_THRESHOLD_MM:g} mm by sector",
            _by_sector,
        ),
    )
}
METRIC_REGISTRY = Registry("metrics", METRICS)
# What geometric missions predict of them (`nbv.geometric.completeness`); the others need a cloud.
PREDICTED = ("completeness_{t}mm", "f_score_{t}mm", "f_score_auc")


def all_metrics() -> dict[str, Metric]:
    """Those built in, then those of plug-ins."""
    found = {plugin.loaded.key: plugin for plugin in METRIC_REGISTRY.plugins().values()}
    for taken in METRICS.keys() & found.keys():
        leave_out(found.pop(taken))
    return {**METRICS, **{key: plugin.loaded for key, plugin in found.items()}}


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
