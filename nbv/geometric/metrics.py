"""The simulated mission's scores, under the names that photogrammetric missions use."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from nbv.config import MissionConfig
from nbv.evaluation.metric import (
    area_under_curve,
    azimuth_sectors,
    f_score,
    sector_centers_deg,
    share_by_sector,
)
from nbv.evaluation.registry import SECTOR_THRESHOLD_MM
from nbv.geometric.completeness import best_so_far, within_reach
from nbv.geometric.world import GeometricWorld
from nbv.types import Floats


def predicted_metrics(world: GeometricWorld, probability: Floats, config: MissionConfig) -> dict[str, Any]:
    """Expected scores of a cloud that holds each surface sample with its probability (S,).

    ``completeness_{t}mm`` is predicted. Nothing is predicted about wrong points: ``f_score_{t}mm`` takes
    every reconstructed point as right (accuracy 100 %), so it only re-expresses completeness on the scale
    of the photogrammetric score. Distances (C2C, Hausdorff) are not predicted and are absent.
    """
    thresholds = sorted({*config.evaluation.thresholds_mm, SECTOR_THRESHOLD_MM})
    best = best_so_far(probability, world.neighbours_by_rank)
    reached = {t: within_reach(best, world.reach_counts(t / 1000.0)) for t in thresholds}
    sectors = azimuth_sectors(world.samples_m, config.target_m, config.evaluation.azimuth_sectors)
    everything = np.ones(len(probability), dtype=bool)
    metrics: dict[str, Any] = {
        "fidelity": "geometric",
        "sector_centers_deg": sector_centers_deg(config.evaluation.azimuth_sectors).tolist(),
    }
    for surface, mask in (("whole", everything), ("observable", world.observable)):
        scores = _scores({t: p[mask] for t, p in reached.items()}, config.evaluation.thresholds_mm)
        scores[f"sector_completeness_{SECTOR_THRESHOLD_MM:g}mm"] = share_by_sector(
            sectors[mask], reached[SECTOR_THRESHOLD_MM][mask], config.evaluation.azimuth_sectors
        )
        scores["n_gt_samples"] = int(mask.sum())
        metrics[surface] = scores
    return metrics


def _scores(reached: dict[float, Floats], thresholds_mm: Sequence[float]) -> dict[str, Any]:
    scores: dict[str, Any] = {}
    curve = []
    for t in sorted(thresholds_mm):
        completeness = 100.0 * float(reached[t].mean())
        scores[f"completeness_{t:g}mm"] = completeness
        scores[f"f_score_{t:g}mm"] = f_score(100.0, completeness)
        curve.append(scores[f"f_score_{t:g}mm"])
    scores["f_score_auc"] = area_under_curve(sorted(thresholds_mm), curve)
    return scores
