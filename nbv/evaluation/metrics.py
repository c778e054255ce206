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

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nbv.config import EvaluationConfig
from nbv.errors import MissionFailure
from nbv.evaluation.ground_truth import GroundTruthSamples
from nbv.evaluation.measures import azimuth_sectors, sector_centers_deg
from nbv.evaluation.registry import Distances, measure_all
from nbv.evaluation.voxels import voxel_scores
from nbv.geometry.neighbours import nearest_neighbours
from nbv.types import Floats, PointCloud

PAPER_CODE_GATE_M = 0.05


@dataclass(frozen=True)
class Metrics:
    """All scores of one cleaned cloud.

    ``whole`` and ``observable`` are what a mission reports: after the ground-truth gate if
    ``EvaluationConfig.gt_gate_m`` turns it on, else without. ``ungated`` and ``gated`` hold both variants
    by name; ``gated`` uses the configured gate, or 50 mm if that is off, and is None when the gate leaves
    no point. Of these only the one that is reported has Tanks and Temples' scores, the other None.

    Each surface holds the metrics of `nbv.evaluation.registry`; ``n_gt_samples``; and, where floors were given, what a
    perfect reconstruction of this rock would get: ``hausdorff_{direction}_floor_mm``.
    """

    n_points: int
    gt_gate_m: float
    sector_centers_deg: list[float]
    whole: dict[str, Any]
    observable: dict[str, Any]
    ungated: dict[str, Any]
    gated: dict[str, Any] | None

    def to_dict(self) -> dict[str, Any]:
        """Plain dictionary, ready for JSON."""
        return asdict(self)


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
    gates = config.gt_gate_m > 0
    ungated = _variant(None if gates else points, to_cloud, to_gt, truth, sectors, config, floors or {})

    gate_m = config.gt_gate_m if gates else PAPER_CODE_GATE_M
    kept = to_gt <= gate_m
    gated = None
    if kept.any():
        # Only samples whose nearest point the gate removed need another query.
        gated_to_cloud = to_cloud.copy()
        orphans = ~kept[nearest]
        if orphans.any():
            gated_to_cloud[orphans], _ = nearest_neighbours(points[kept], truth.points_m[orphans])
        gated_points = points[kept] if gates else None
        variant = _variant(gated_points, gated_to_cloud, to_gt[kept], truth, sectors, config, floors or {})
        gated = {"gt_gate_m": gate_m, **variant}
    if gates and gated is None:
        raise MissionFailure(
            "empty_cloud", f"no reconstructed point lies within the {1000 * gate_m:.0f} mm ground-truth gate"
        )
    headline = gated if gates and gated is not None else ungated
    return Metrics(
        n_points=headline["n_points"],
        gt_gate_m=config.gt_gate_m,
        sector_centers_deg=sector_centers_deg(config.azimuth_sectors).tolist(),
        whole=headline["whole"],
        observable=headline["observable"],
        ungated=ungated,
        gated=gated,
    )


def _variant(
    points_m: Floats | None,
    to_cloud_m: Floats,
    to_gt_m: Floats,
    truth: GroundTruthSamples,
    sectors: NDArray[np.int64],
    config: EvaluationConfig,
    floors: Mapping[str, Mapping[str, float]],
) -> dict[str, Any]:
    everything = np.ones(len(to_cloud_m), dtype=bool)
    out: dict[str, Any] = {"n_points": len(to_gt_m)}
    # The most expensive scores, so only of the variant that the mission reports.
    voxels = {} if points_m is None else {t: voxel_scores(points_m, truth, t) for t in config.thresholds_mm}
    for name, mask in (("whole", everything), ("observable", truth.observable)):
        by_voxel = {t: scores[name] for t, scores in voxels.items()}
        distances = Distances(1000.0 * to_cloud_m[mask], 1000.0 * to_gt_m, sectors[mask], config, by_voxel)
        out[name] = {**measure_all(distances), "n_gt_samples": int(mask.sum()), **floors.get(name, {})}
    return out
