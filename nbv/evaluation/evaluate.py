"""From a dense cloud and the true rock to the mission's metrics."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from nbv.cache import Store
from nbv.config import MissionConfig
from nbv.evaluation.cleaning import clean_cloud
from nbv.evaluation.ground_truth import GroundTruthSamples, ground_truth, rock_floors
from nbv.evaluation.registration import (
    COARSE_REACHES_M,
    REACHES_M,
    moved,
    place_on_target,
    register_cloud,
)
from nbv.evaluation.registry import compute_metrics
from nbv.geometry.raycasting import RayCaster
from nbv.rocks import Rock
from nbv.types import Cloud, PointCloud


@dataclass(frozen=True)
class Evaluation:
    """What was measured of a cloud."""

    metrics: dict[str, Any]  # see `compute_metrics`
    cleaning: dict[str, float]  # points after each cleaning step
    cleaned: PointCloud  # the cloud that was measured


def evaluate_cloud(cloud: Cloud, rock: Rock, config: MissionConfig, store: Store | None = None) -> Evaluation:
    """Clean a dense cloud and measure it; what concerns the rock alone is kept in ``store``.

    Where telemetry errs by more than centimetres the metrics also hold ``registered``: the same scores of the cloud after the similarity that
    fits it best to the true surface (`nbv.evaluation.registration`), and that similarity in numbers.
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
    if not config.telemetry.places_well:
        metrics["registered"] = _registered(cloud, truth, config, measure)
    return Evaluation(metrics, report, cleaned)


def _registered(
    cloud: Cloud,
    truth: GroundTruthSamples,
    config: MissionConfig,
    measure: Callable[[PointCloud], dict[str, Any]],
) -> dict[str, Any]:
    """Both surfaces' scores after registration, and the similarity that it found.

    In three steps, since the crop and the ground's removal, which come first, are only right once the cloud lies right:
    the target in the cloud is put where the target is, then registered coarsely, then to the end.
    """
    truth_from_cloud = place_on_target(cloud.points_m, np.asarray(config.target_m))
    bare = PointCloud(cloud.points_m)
    for reaches_m in (COARSE_REACHES_M, REACHES_M):
        placed, _ = clean_cloud(moved(bare, truth_from_cloud), config.evaluation, config.target_m)
        step = register_cloud(placed.points_m, truth.points_m, reaches_m)
        truth_from_cloud = step.after(truth_from_cloud)
    measured = measure(moved(placed, step))
    centre_m = np.asarray(config.target_m)
    return {
        "whole": measured["whole"],
        "observable": measured["observable"],
        "scale": truth_from_cloud.scale,
        "turn_deg": truth_from_cloud.turn_deg,
        "shift_of_target_m": float(np.linalg.norm(truth_from_cloud.apply(centre_m) - centre_m)),
    }
