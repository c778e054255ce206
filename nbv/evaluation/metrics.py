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

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nbv.config import EvaluationConfig
from nbv.errors import MissionFailure
from nbv.evaluation.ground_truth import GroundTruthSamples
from nbv.geometry.neighbours import nearest_neighbours
from nbv.types import Floats, PointCloud

PAPER_CODE_GATE_M = 0.05
SECTOR_THRESHOLD_MM = 48.0  # 3 % of the rock's height: the paper's Fig. 3


@dataclass(frozen=True)
class Metrics:
    """All scores of one cleaned cloud.

    ``whole`` and ``observable`` are what a mission reports: after the ground-truth gate if
    ``EvaluationConfig.gt_gate_m`` turns it on, else without. ``ungated`` and ``gated`` hold both variants
    by name; ``gated`` uses the configured gate, or 50 mm if that is off, and is None when the gate leaves
    no point.

    Each surface holds, in mm and percent: ``hausdorff_gt_to_cloud_mm`` (the paper's),
    ``hausdorff_cloud_to_gt_mm``, ``hausdorff_symmetric_mm``; ``c2c_{mean,median,p95}_mm`` (the paper's,
    gt -> cloud) and ``c2c_cloud_to_gt_{mean,median,p95}_mm``; ``completeness_{t}mm``, ``accuracy_{t}mm``,
    ``f_score_{t}mm``; ``f_score_auc``; ``sector_completeness_48mm`` (list, None where a sector holds no
    sample); ``n_gt_samples``; and, where floors were given, what a perfect reconstruction of this rock
    would get: ``hausdorff_{direction}_floor_mm``.
    """

    n_points: int
    gt_gate_m: float
    sector_centers_deg: tuple[float, ...]
    whole: dict[str, Any]
    observable: dict[str, Any]
    ungated: dict[str, Any]
    gated: dict[str, Any] | None

    def to_dict(self) -> dict[str, Any]:
        """Plain dictionary, ready for JSON."""
        return {
            "n_points": self.n_points,
            "gt_gate_m": self.gt_gate_m,
            "sector_centers_deg": list(self.sector_centers_deg),
            "whole": self.whole,
            "observable": self.observable,
            "ungated": self.ungated,
            "gated": self.gated,
        }


def compute_metrics(
    cloud: PointCloud,
    truth: GroundTruthSamples,
    config: EvaluationConfig,
    target_m: tuple[float, float, float] | Floats = (0.0, 0.0, 0.8),
    to_surface_m: Floats | None = None,
    floors: Mapping[str, Mapping[str, float]] | None = None,
) -> Metrics:
    """Score a cleaned cloud against the reference.

    Parameters
    ----------
    cloud
        (N, 3) points in the world frame.
    truth
        Samples of the whole surface and the observable mask.
    target_m
        Axis of the azimuth sectors (x and y are used).
    to_surface_m
        (N,) exact distances from the points to the reference surface (`RayCaster.distances_m`). Without them
        the nearest sample stands for the surface, which adds about half the samples' spacing to every
        ``cloud -> gt`` distance (several millimetres at 50,000 samples on a 1.6 m rock).
    floors
        By surface, values of the rock itself to report beside the scores (`nbv.evaluation.floor`).

    Raises
    ------
    MissionFailure
        ``empty_cloud``: no point, or none within the configured gate.
    ValueError
        A point is not finite, or no sample is observable.
    """
    points = np.asarray(cloud.points_m, dtype=float)
    if len(points) == 0:
        raise MissionFailure("empty_cloud", "the cleaned cloud holds no point, so there is nothing to score")
    if not np.isfinite(points).all():
        raise ValueError("the cloud holds points that are not finite")
    if not truth.observable.any():
        raise ValueError("no ground-truth sample is observable; check the camera shell")

    if to_surface_m is None:
        to_gt, _ = nearest_neighbours(truth.points_m, points)
    else:
        to_gt = np.asarray(to_surface_m, dtype=float)
        if to_gt.shape != (len(points),):
            raise ValueError(f"to_surface_m has shape {to_gt.shape}, the cloud {len(points)} points")
    to_cloud, nearest = nearest_neighbours(points, truth.points_m)
    sectors = azimuth_sectors(truth.points_m, target_m, config.azimuth_sectors)
    ungated = _variant(to_cloud, to_gt, truth, sectors, config, floors or {})

    gate_m = config.gt_gate_m if config.gt_gate_m > 0 else PAPER_CODE_GATE_M
    kept = to_gt <= gate_m
    gated = None
    if kept.any():
        # Only samples whose nearest point the gate removed need another query.
        gated_to_cloud = to_cloud.copy()
        orphans = ~kept[nearest]
        if orphans.any():
            gated_to_cloud[orphans], _ = nearest_neighbours(points[kept], truth.points_m[orphans])
        variant = _variant(gated_to_cloud, to_gt[kept], truth, sectors, config, floors or {})
        gated = {"gt_gate_m": gate_m, **variant}
    if config.gt_gate_m > 0 and gated is None:
        raise MissionFailure(
            "empty_cloud", f"no reconstructed point lies within the {1000 * gate_m:.0f} mm ground-truth gate"
        )
    headline = gated if config.gt_gate_m > 0 and gated is not None else ungated
    return Metrics(
        n_points=headline["n_points"],
        gt_gate_m=config.gt_gate_m,
        sector_centers_deg=tuple(sector_centers_deg(config.azimuth_sectors)),
        whole=headline["whole"],
        observable=headline["observable"],
        ungated=ungated,
        gated=gated,
    )


def _variant(
    to_cloud_m: Floats,
    to_gt_m: Floats,
    truth: GroundTruthSamples,
    sectors: NDArray[np.int64],
    config: EvaluationConfig,
    floors: Mapping[str, Mapping[str, float]],
) -> dict[str, Any]:
    everything = np.ones(len(to_cloud_m), dtype=bool)
    out: dict[str, Any] = {"n_points": len(to_gt_m)}
    for name, mask in (("whole", everything), ("observable", truth.observable)):
        scores: dict[str, Any] = dict(distance_scores(to_cloud_m[mask], to_gt_m, config.thresholds_mm))
        scores[f"sector_completeness_{SECTOR_THRESHOLD_MM:g}mm"] = sector_completeness(
            to_cloud_m[mask], sectors[mask], config.azimuth_sectors, SECTOR_THRESHOLD_MM
        )
        scores["n_gt_samples"] = int(mask.sum())
        scores.update(floors.get(name, {}))
        out[name] = scores
    return out


def distance_scores(to_cloud_m: Floats, to_gt_m: Floats, thresholds_mm: Sequence[float]) -> dict[str, float]:
    """All scalar scores of two non-empty sets of nearest-neighbour distances in metres.

    Parameters
    ----------
    to_cloud_m
        (S,) from each reference sample to the cloud.
    to_gt_m
        (N,) from each reconstructed point to the reference.
    """
    forward, backward = 1000.0 * np.asarray(to_cloud_m), 1000.0 * np.asarray(to_gt_m)
    scores = hausdorff_mm(to_cloud_m, to_gt_m)
    for prefix, distance in (("c2c", forward), ("c2c_cloud_to_gt", backward)):
        scores[f"{prefix}_mean_mm"] = float(distance.mean())
        scores[f"{prefix}_median_mm"] = float(np.median(distance))
        scores[f"{prefix}_p95_mm"] = float(np.percentile(distance, 95))
    ordered = sorted(thresholds_mm)
    curve = []
    for t in ordered:
        recall, precision = 100.0 * float((forward < t).mean()), 100.0 * float((backward < t).mean())
        scores[f"completeness_{t:g}mm"] = recall
        scores[f"accuracy_{t:g}mm"] = precision
        scores[f"f_score_{t:g}mm"] = f_score(precision, recall)
        curve.append(scores[f"f_score_{t:g}mm"])
    scores["f_score_auc"] = area_under_curve(ordered, curve)
    return scores


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
    to_cloud_m: Floats, sectors: NDArray[np.int64], count: int, threshold_mm: float
) -> list[float | None]:
    """Completeness in percent per sector; None where a sector holds no sample."""
    reached = 1000.0 * to_cloud_m < threshold_mm
    total = np.bincount(sectors, minlength=count)
    hit = np.bincount(sectors, weights=reached, minlength=count)
    return [100.0 * float(h) / int(n) if n else None for h, n in zip(hit, total)]


def voxel_scores(points_m: Floats, gt_points_m: Floats, thresholds_mm: Sequence[float]) -> dict[str, float]:
    """Tanks and Temples' density-independent variant: both clouds are first averaged in voxels of t / 2.

    A cross-check of the plain scores, which weight a region by how densely it was reconstructed.

    Returns
    -------
    ``voxel_completeness_{t}mm``, ``voxel_accuracy_{t}mm``, ``voxel_f_score_{t}mm`` in percent.
    """
    if len(points_m) == 0:
        raise MissionFailure("empty_cloud", "the cloud holds no point, so there is nothing to score")
    scores = {}
    for t in sorted(thresholds_mm):
        cloud, gt = (voxel_means(p, t / 2000.0) for p in (points_m, gt_points_m))
        recall = 100.0 * float((nearest_neighbours(cloud, gt)[0] < t / 1000.0).mean())
        precision = 100.0 * float((nearest_neighbours(gt, cloud)[0] < t / 1000.0).mean())
        scores[f"voxel_completeness_{t:g}mm"] = recall
        scores[f"voxel_accuracy_{t:g}mm"] = precision
        scores[f"voxel_f_score_{t:g}mm"] = f_score(precision, recall)
    return scores


def voxel_means(points_m: Floats, voxel_m: float) -> Floats:
    """(V, 3) mean of the points in each occupied voxel, in lexicographic voxel order."""
    _, inverse, counts = np.unique(
        np.floor(points_m / voxel_m).astype(np.int64), axis=0, return_inverse=True, return_counts=True
    )
    inverse = inverse.reshape(-1)
    sums = np.stack([np.bincount(inverse, weights=points_m[:, k]) for k in range(3)], axis=1)
    return sums / counts[:, None]
