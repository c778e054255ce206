"""Distances between a cleaned cloud and the reference surface, and the scores made from them.

Directions. ``gt -> cloud`` runs from each reference sample to its nearest reconstructed point: it
measures what is missing (completeness, recall). ``cloud -> gt`` runs from each reconstructed point to
its nearest reference sample: it measures what is wrong (accuracy, precision). The paper's C2C family and
its Hausdorff distance are ``gt -> cloud``.

Surfaces. ``whole`` is the complete reference surface, underside included, as in the paper. ``observable``
keeps the samples that at least two reachable cameras can see. ``cloud -> gt`` distances run to the whole
surface in both: a point reconstructed on a hardly observable facet is right, not wrong.

Thresholds are strict: a distance counts when it is less than t, as in Tanks and Temples (Knapitsch et
al. 2017, Eq. 4 to 8). The authors' code uses "at most"; on measured distances the two agree.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from nbv.config import EvaluationConfig
from nbv.errors import MissionFailure
from nbv.evaluation.ground_truth import GroundTruthSamples
from nbv.evaluation.metric import Distances, azimuth_sectors, sector_centers_deg
from nbv.evaluation.registry import measure_all
from nbv.geometry.neighbours import nearest_neighbours
from nbv.types import Floats, PointCloud


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

    Returns
    -------
    ``n_points`` that were measured, ``gt_gate_m``, ``sector_centers_deg``, and for each surface, ``whole`` and
    ``observable``, the metrics of `nbv.evaluation.registry` and ``n_gt_samples``.
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
