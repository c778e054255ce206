"""The named configurations that a user starts from."""

from __future__ import annotations

from typing import Any

from nbv.config.mission_config import MissionConfig
from nbv.errors import UserError

# Ours, in both presets of the paper: work left out that the outcome does not show
# (docs/results/reduced_sfm.md). Not defaults, so that the record of an earlier mission, which lacks these fields, means what it
# meant.
ECONOMIES: dict[str, Any] = {
    "sparse.max_pairs": 8,
    "sparse.min_ransac_trials": 30,  # nine matches of ten are right; where fewer are, COLMAP goes on by itself
    "sparse.global_ba_interval": 20,
    "sparse.local_ba_images": 3,
    "sparse.local_ba_rounds": 1,
    "sparse.local_ba_iterations": 2,
    "sparse.global_ba_iterations": 1,
    "sparse.update_pairs": "near",
    "dense.min_baseline_angle_deg": 40.0,
    "dense.search": "sparse",
}


def paper() -> MissionConfig:
    """The paper's text."""
    return MissionConfig().with_values(ECONOMIES)


def paper_code() -> MissionConfig:
    """What the authors' public code executes where it departs from the text."""
    return MissionConfig(preset="paper-code").with_values(
        {
            **ECONOMIES,
            "pool.min_altitude_m": 1.5,  # rejects the whole 10 degree ring
            "b_aware.alpha_track": 0.5,
            "b_aware.alpha_density": 0.3,
            "b_aware.alpha_reprojection": 0.2,
            "stop.criterion": "budget",
            "gate.oracle_coverage": "paper-code",
            "sparse.max_features": 16384,
            "sparse.max_pair_angle_deg": 180.0,  # exhaustive matching
            "sparse.max_pairs": 0,
            "evaluation.gt_gate_m": 0.05,
        }
    )


def campaign() -> MissionConfig:
    """Ours: the small budget and strict agreement at which configurations can be told apart.

    Chosen by ``gatetune study noise`` on training rocks (docs/results/noise_floor.md).
    """
    return MissionConfig(preset="campaign").with_values(
        {
            "stop.adaptive_budget": 8,
            "stop.criterion": "budget",
            "stop.knn_region": "box",  # far ground points would drown the rock in the statistic
            "sparse.first_octave": 0,
            "sparse.max_features": 4096,
            "sparse.max_pairs": 24,  # as in all that was measured with this preset
            "dense.agreeing_views": 6,
            "evaluation.gt_samples": 50_000,
        }
    )


PRESETS = {"paper": paper, "paper-code": paper_code, "campaign": campaign}


def preset(name: str) -> MissionConfig:
    """The preset called ``name``; ``UserError`` if there is none."""
    if name not in PRESETS:
        raise UserError(f"unknown preset {name!r}; there are {', '.join(PRESETS)}")
    return PRESETS[name]()
