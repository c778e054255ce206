"""From a dense cloud and the true rock to the mission's metrics."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy

from nbv.cache import Store
from nbv.config import MissionConfig
from nbv.evaluation.cleaning import clean_cloud
from nbv.evaluation.ground_truth import ground_truth, rock_floors
from nbv.evaluation.registry import compute_metrics
from nbv.geometry.frames import Similarity, align_umeyama
from nbv.geometry.mesh import RayCaster
from nbv.geometry.target import find_target
from nbv.rocks import Rock
from nbv.types import Cloud, Floats, PointCloud

# Registration of a dense cloud to the true surface, for the second number that an evaluation says.
#
# Where telemetry errs, a cloud can be right in shape and wrong in place. As georeferenced it is measured where the
# vehicle's telemetry puts it; registered it is measured after the similarity that fits it best to the true surface, as
# Tanks and Temples does (Knapitsch et al. 2017, section 4.2): iterative closest point (Besl and McKay 1992), with
# correspondences up to a distance that shrinks in stages; first a shift alone, from 0.2 m on with turn and scale
# (Umeyama 1991). It starts from the shift that puts the target found in the cloud on the true one (`place_on_target`).
#
# Open3D's ICP has no stage that only shifts, and its numbers are others: registered scores of earlier missions would not compare.


REACHES_M = (1.0, 0.5, 0.2, 0.1, 0.05)  # of correspondences, coarse to fine
COARSE_REACHES_M = REACHES_M[:3]  # enough to crop the cloud and to find its ground
ROUNDS = 25  # per stage, at most
MAX_POINTS = 6_000  # of the cloud, evenly picked: a similarity has seven parameters
COARSE_POINTS = 2_000  # the same where correspondences reach 0.2 m and farther
_FINE_REACH_M = 0.2
_STILL_M = 1e-5  # a round that moves the cloud less than this ends its stage
_MIN_PAIRS = 50
_TARGET_POINTS = 20_000  # to look for the target among


def place_on_target(points_m: Floats, target_m: Floats) -> Similarity:
    """The shift that brings the target that stands in the cloud (N, 3) to where it really is, ``target_m`` (3,).

    Where none is found in the cloud, its middle is taken for the target's.
    """
    points = _picked(np.asarray(points_m, dtype=float), _TARGET_POINTS)
    target = find_target(points, points.mean(axis=0))
    center_m = np.percentile(points, [1.0, 99.0], axis=0).mean(axis=0) if target is None else target.center_m
    return Similarity(1.0, np.eye(3), np.asarray(target_m, dtype=float) - center_m)


def register_cloud(points_m: Floats, truth_m: Floats, reaches_m: tuple[float, ...] = REACHES_M) -> Similarity:
    """``truth_from_cloud``: the similarity that fits the cloud (N, 3) to samples (S, 3) of the true surface.

    Coarse stages shift the cloud alone, with correspondences from each of its points to the nearest sample: half a rock,
    as hard light leaves it, belongs on its half. Fine stages turn and scale it too, and have correspondences from each
    sample to the nearest point as well: one direction alone would shrink the cloud into a corner of the surface.
    Identity where nothing is within reach.
    """
    truth_from_cloud = Similarity(1.0, np.eye(3), np.zeros(3))
    for reach_m in reaches_m:
        count = COARSE_POINTS if reach_m >= _FINE_REACH_M else MAX_POINTS
        cloud, truth = (_picked(np.asarray(p, dtype=float), count) for p in (points_m, truth_m))
        to_truth = scipy.spatial.cKDTree(truth)
        moved = truth_from_cloud.apply(cloud)
        for _ in range(ROUNDS):
            forward_m, nearest = to_truth.query(moved, distance_upper_bound=reach_m)
            ahead = np.isfinite(forward_m)
            source, target = cloud[ahead], truth[nearest[ahead]]
            if reach_m <= _FINE_REACH_M:
                backward_m, owner = scipy.spatial.cKDTree(moved).query(truth, distance_upper_bound=reach_m)
                behind = np.isfinite(backward_m)
                source = np.concatenate([source, cloud[owner[behind]]])
                target = np.concatenate([target, truth[behind]])
            if len(source) < _MIN_PAIRS:
                break
            if reach_m > _FINE_REACH_M:
                truth_from_cloud = Similarity(1.0, np.eye(3), (target - source).mean(axis=0))
            else:
                truth_from_cloud = align_umeyama(target, source)
            before, moved = moved, truth_from_cloud.apply(cloud)
            if np.abs(moved - before).max() < _STILL_M:
                break
    return truth_from_cloud


def moved(cloud: Cloud, target_from_cloud: Similarity) -> PointCloud:
    """The cloud in another frame."""
    normals = None if cloud.normals is None else cloud.normals @ target_from_cloud.rotation.T
    return PointCloud(target_from_cloud.apply(cloud.points_m), cloud.colors, normals)


def _picked(points: Floats, count: int) -> Floats:
    return points[:: max(1, len(points) // count)]


@dataclass(frozen=True)
class Evaluation:
    """What was measured of a cloud."""

    metrics: dict[str, Any]  # see `compute_metrics`
    cleaning: dict[str, float]  # points after each cleaning step
    cleaned: PointCloud  # the cloud that was measured


def evaluate_cloud(cloud: Cloud, rock: Rock, config: MissionConfig, store: Store | None = None) -> Evaluation:
    """Clean a dense cloud and measure it; what concerns the rock alone is kept in ``store``.

    Where telemetry errs by more than centimetres the metrics also hold ``registered``: the same scores of the cloud after the similarity that
    fits it best to the true surface (`nbv.evaluation.evaluate`), and that similarity in numbers.
    """
    cleaned, report = clean_cloud(cloud, config.evaluation, config.target_m)
    truth = ground_truth(rock, config, store)
    floors = rock_floors(rock, truth, config, store)
    caster = RayCaster(rock.vertices_m, rock.faces)

    def measure(measured: PointCloud) -> dict[str, Any]:
        to_surface_m = caster.distances_m(measured.points_m)
        metrics = compute_metrics(measured, truth, config.evaluation, config.target_m, to_surface_m)
        return {**metrics, **{surface: {**metrics[surface], **floors[surface]} for surface in floors}}

    metrics = measure(cleaned)
    if config.telemetry.places_well:
        return Evaluation(metrics, report, cleaned)
    # In three steps, since the crop and the ground's removal, which come first, are only right once the cloud lies right:
    # the target in the cloud is put where the target is, then registered coarsely, then to the end.
    truth_from_cloud = place_on_target(cloud.points_m, np.asarray(config.target_m))
    bare = PointCloud(cloud.points_m)
    for reaches_m in (COARSE_REACHES_M, REACHES_M):
        placed, _ = clean_cloud(moved(bare, truth_from_cloud), config.evaluation, config.target_m)
        step = register_cloud(placed.points_m, truth.points_m, reaches_m)
        truth_from_cloud = step.after(truth_from_cloud)
    measured = measure(moved(placed, step))
    centre_m = np.asarray(config.target_m)
    metrics["registered"] = {
        "whole": measured["whole"],
        "observable": measured["observable"],
        "scale": truth_from_cloud.scale,
        "turn_deg": truth_from_cloud.turn_deg,
        "shift_of_target_m": float(np.linalg.norm(truth_from_cloud.apply(centre_m) - centre_m)),
    }
    return Evaluation(metrics, report, cleaned)
