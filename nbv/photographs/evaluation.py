"""A mission's cloud against a set's dense reference, since there is no true surface.

Scores have the names that they have on rocks, and their meaning on a rock of 1.6 m: 48 mm stand for 3 % of the object's
height. Cloud and reference are scaled to that height before they are compared.

The cloud is registered first (`nbv.evaluation.registration`): it lies where the alignment with telemetry has put it. Of
the cloud only what lies within `MARGIN` of the reference's box and not below it counts, as in Tanks and Temples, and what
most masks show as the object. The ground plane is not removed: the reference has no ground, and on a low object part of the
surface may be a plane itself (a quarter of a mound of sand was lost so).
"""

from __future__ import annotations

import dataclasses

import numpy as np

from nbv.config import EvaluationConfig
from nbv.errors import MissionFailure
from nbv.evaluation import Evaluation
from nbv.evaluation.cleaning import clean_cloud, select
from nbv.evaluation.ground_truth import GroundTruthSamples
from nbv.evaluation.registration import moved, register_cloud
from nbv.evaluation.registry import compute_metrics
from nbv.geometry.neighbours import nearest_neighbours
from nbv.photographs.object_frame import IN_MASK
from nbv.photographs.photograph_set import THRESHOLD_FRACTIONS, PhotographSet
from nbv.random_streams import keyed_rng
from nbv.rocks import DEFAULT_HEIGHT_M
from nbv.types import Bools, Cloud, Floats, PointCloud

MARGIN = 0.1  # of the height, about the reference's box
REACHES = (0.125, 0.06, 0.03)  # of correspondences, of the height: 0.2, 0.1 and 0.05 of a rock of 1.6 m
MASKS = 16  # of a set are asked, evenly picked


def measure_cloud(cloud: Cloud, photographs: PhotographSet, config: EvaluationConfig) -> Evaluation:
    """Of a mission's cloud in the set's frame; both surfaces, ``whole`` and ``observable``, are the dense reference.

    `MissionFailure` where nothing is left after cleaning.
    """
    reference_m = photographs.reference().points_m
    truth_m = _picked(reference_m, config.gt_samples, photographs.name)
    low, high = reference_m.min(axis=0), reference_m.max(axis=0)
    margin_m = MARGIN * photographs.height_m
    half_m = float(np.abs([low - photographs.target_m, high - photographs.target_m]).max()) + margin_m
    no_ground = dataclasses.replace(config, crop_half_extent_m=half_m, ground_ransac_iterations=0)
    cleaned, report = clean_cloud(cloud, no_ground, photographs.target_m)
    low, high = low - [margin_m, margin_m, 0.0], high + margin_m
    reaches_m = tuple(reach * photographs.height_m for reach in REACHES)
    registration = register_cloud(_within(cleaned, low, high).points_m, truth_m, reaches_m)
    cleaned = _within(moved(cleaned, registration), low, high)
    cleaned = select(cleaned, in_masks(cleaned.points_m, photographs))
    if len(cleaned) == 0:
        raise MissionFailure("empty_cloud", "no dense point lies near the reference")
    scale = DEFAULT_HEIGHT_M / photographs.height_m
    to_reference_m, _ = nearest_neighbours(reference_m, cleaned.points_m)
    truth = GroundTruthSamples(scale * truth_m, np.ones(len(truth_m), dtype=bool))
    scaled = PointCloud(scale * cleaned.points_m, cleaned.colors, cleaned.normals)
    metrics = compute_metrics(scaled, truth, config, (0.0, 0.0, DEFAULT_HEIGHT_M / 2), scale * to_reference_m)
    metrics["reference"] = {
        "registration": {"scale": registration.scale, "turn_deg": registration.turn_deg},
        "ceiling": ceiling(photographs),
    }
    metrics["cleaning"] = report
    return Evaluation(metrics, report, cleaned)


def ceiling(photographs: PhotographSet) -> dict[str, float]:
    """One half of the photographs against the other, by the names of the metrics: the reference cannot tell better scores apart."""
    halves = photographs.halves
    scores = {}
    for k, fraction in enumerate(THRESHOLD_FRACTIONS):
        name = f"{1000 * fraction * DEFAULT_HEIGHT_M:.0f}mm"
        scores[f"f_score_{name}"] = halves.f_score[k]
        scores[f"completeness_{name}"] = halves.completeness[k]
        scores[f"accuracy_{name}"] = halves.precision[k]
    return scores


def _within(cloud: Cloud, low_m: Floats, high_m: Floats) -> PointCloud:
    inside = (cloud.points_m >= low_m) & (cloud.points_m <= high_m)
    return select(cloud, np.all(inside, axis=1))


def in_masks(points_m: Floats, photographs: PhotographSet) -> Bools:
    """(N,) which points (N, 3) lie on the object in half of the masks that show them; all where the set has none."""
    masked = [p for p in photographs.registered if p.masked]
    outside, shown = np.zeros(len(points_m)), np.zeros(len(points_m))
    camera = photographs.camera
    for photograph in masked[:: max(1, len(masked) // MASKS)]:
        mask, pose = photographs.mask(photograph.name), photograph.camera_from_world
        assert mask is not None and pose is not None
        seen_m = points_m @ pose[:3, :3].T + pose[:3, 3]
        at_px = camera.focal_px * seen_m[:, :2] / seen_m[:, 2:] + [camera.width_px / 2, camera.height_px / 2]
        there = (seen_m[:, 2] > 0) & (at_px >= 0).all(axis=1) & (at_px < mask.shape[::-1]).all(axis=1)
        column, row = at_px[there].astype(int).T
        shown += there
        outside[there] += ~mask[row, column]
    inside: Bools = outside <= (1.0 - IN_MASK) * shown
    return inside


def _picked(points_m: Floats, count: int, key: str) -> Floats:
    """At most ``count`` of the points, drawn."""
    if len(points_m) <= count:
        return points_m
    chosen = keyed_rng("reference-samples", key).choice(len(points_m), count, replace=False)
    return points_m[np.sort(chosen)]
