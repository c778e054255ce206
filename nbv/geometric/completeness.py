"""Which surface samples the dense stage would reconstruct, from visibility and angles alone, and the scores of that."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from nbv.config import MissionConfig
from nbv.evaluation.registry import (
    SECTOR_THRESHOLD_MM,
    area_under_curve,
    azimuth_sectors,
    f_score,
    sector_centers_deg,
    share_by_sector,
)
from nbv.geometric.world import GeometricWorld, resolution, resolved
from nbv.geometry.frames import angles_deg, directions_from
from nbv.geometry.stereo_chance import depth_probability, reconstruction_probability
from nbv.geometry.visibility import incidences_deg
from nbv.types import Bools, Floats, Floats32, Ints

CHANCES_IN_REACH = 2.0
RESOLVED = 2.0  # a pixel's area decides (`nbv.geometric.world.RESOLVED`)


def sample_probability(
    world: GeometricWorld,
    seen: Bools,
    camera_centers_m: Floats,
    config: MissionConfig,
) -> Floats:
    """(S,) `reconstruction_probability` of a world's samples, which the views (V, S) ``seen`` from (V, 3) see."""
    directions, incidence = _angles(world, camera_centers_m, config)
    chance = reconstruction_probability(seen, incidence, world.sample_contrast, directions, config.dense)
    return resolved(chance.astype(np.float64), world.camera, RESOLVED)


def coarse_depth(
    world: GeometricWorld, seen: Bools, camera_centers_m: Floats, config: MissionConfig, draws: Floats
) -> tuple[Floats, Ints]:
    """Places (K, 3) of the depth that stereo at low resolution would give, holes left out, and whose depth they are (K,).

    ``draws`` (S,) in [0, 1) decide: a place with less than a view's chance of a depth has one.
    """
    directions, incidence = _angles(world, camera_centers_m, config)
    angle_deg = angles_deg(directions, directions)
    chance = depth_probability(seen, incidence, world.sample_contrast, angle_deg, config.dense)
    view, sample = np.nonzero(chance > draws)
    return world.samples_m[sample], view


def _angles(
    world: GeometricWorld, camera_centers_m: Floats, config: MissionConfig
) -> tuple[Floats, Floats32]:
    """(V, 3) unit vectors from the target to the cameras, and (V, S) incidences in degrees."""
    places = (world.samples_m, world.sample_normals, camera_centers_m)
    incidence = incidences_deg(*(place.astype(np.float32) for place in places))  # micrometres decide nothing
    return directions_from(config.target_m, camera_centers_m), incidence


def predicted_metrics(world: GeometricWorld, probability: Floats, config: MissionConfig) -> dict[str, Any]:
    """Expected scores of a cloud that holds each surface sample with its probability (S,).

    ``completeness_{t}mm`` is predicted. Nothing is predicted about wrong points: ``f_score_{t}mm`` takes
    every reconstructed point as right (accuracy 100 %), so it only re-expresses completeness on the scale
    of the photogrammetric score. Distances (C2C, Hausdorff) are not predicted and are absent.
    """
    thresholds = sorted({*config.evaluation.thresholds_mm, SECTOR_THRESHOLD_MM})
    # (K + 1, S) highest probability among each sample's first 0, 1, ..., K neighbours; of none it is 0.
    of_neighbours = [np.zeros((1, len(probability))), probability[world.neighbours_by_rank]]
    best = np.maximum.accumulate(np.concatenate(of_neighbours), axis=0)
    finest = min(1.0, resolution(world.camera))  # coarser pixels place points less well
    # A depth is a matter of a few pixels, so within reach there are `CHANCES_IN_REACH` chances as good as the best neighbour's.
    # Of likelihood, on ten photogrammetric orbits with 3 agreeing views (docs/results/index.md).
    samples = np.arange(best.shape[1])
    counts = {t: world.reach_counts(finest * t / 1000.0) for t in thresholds}
    reached = {t: 1.0 - np.power(1.0 - best[count, samples], CHANCES_IN_REACH) for t, count in counts.items()}
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
