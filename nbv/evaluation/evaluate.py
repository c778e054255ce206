"""From a dense cloud and the true rock to the mission's metrics."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from nbv.cache import home
from nbv.config import MissionConfig
from nbv.evaluation.cleaning import clean_cloud
from nbv.evaluation.floor import hausdorff_floors
from nbv.evaluation.ground_truth import GroundTruthSamples, build_ground_truth
from nbv.evaluation.metrics import compute_metrics
from nbv.geometry.raycasting import RayCaster
from nbv.rocks import Rock
from nbv.types import Cloud, Floats, PointCloud
from nbv.viewpoints import raw_candidates, seed_viewpoints

_CLEANING_SEED = 0


@dataclass(frozen=True)
class Evaluation:
    """What `evaluate_cloud` found."""

    metrics: dict[str, Any]  # see `nbv.evaluation.metrics.Metrics`
    cleaning: dict[str, float]  # points after each cleaning step
    _make_cleaned: Callable[[], PointCloud]

    @property
    def cleaned(self) -> PointCloud:
        """The cloud that was measured."""
        return self._make_cleaned()


def camera_shell(config: MissionConfig) -> Floats:
    """(C, 3) seed rings and the unfiltered candidate rings: where a mission may photograph from.

    Altitude limits are left out on purpose, so that presets which differ in them are measured against
    the same observable surface.
    """
    return np.array([view.position_m for view in (*seed_viewpoints(config), *raw_candidates(config))])


def ground_truth(rock: Rock, config: MissionConfig) -> GroundTruthSamples:
    """Samples of the true surface and the part that the camera shell can see (kept in the user's cache)."""
    return build_ground_truth(
        rock.vertices_m, rock.faces, camera_shell(config), config.evaluation.gt_samples,
        cache_dir=home() / "ground_truth",
    )  # fmt: skip


def rock_floors(rock: Rock, truth: GroundTruthSamples, config: MissionConfig) -> dict[str, dict[str, float]]:
    """What a perfect reconstruction of the rock's observable surface would get (kept in the user's cache)."""
    return hausdorff_floors(
        rock.vertices_m, rock.faces, truth, camera_shell(config),
        config.dense.fusion_voxel_m, config.evaluation.ground_ransac_threshold_m,
        cache_dir=home() / "ground_truth",
    )  # fmt: skip


def clean_for_evaluation(cloud: Cloud, config: MissionConfig) -> tuple[PointCloud, dict[str, float]]:
    """`clean_cloud` as it comes before the metrics."""
    return clean_cloud(cloud, config.evaluation, config.target_m, _CLEANING_SEED)


def evaluate_cloud(cloud: Cloud, rock: Rock, config: MissionConfig) -> Evaluation:
    """Clean a dense cloud and measure it.

    Raises
    ------
    MissionFailure
        Nothing is left after cleaning.
    """
    cleaned, report = clean_for_evaluation(cloud, config)
    truth = ground_truth(rock, config)
    metrics = compute_metrics(
        cleaned, truth, config.evaluation, config.target_m,
        RayCaster(rock.vertices_m, rock.faces).distances_m(cleaned.points_m), rock_floors(rock, truth, config),
    )  # fmt: skip
    return Evaluation(metrics.to_dict(), report, lambda: cleaned)
