"""Statistics of the sparse model and the budget that every decision is traced with, as a gate may read them.

None depends on the scorers' weights (scores, margins and agreement do), so that a gate made at one
weight vector still means something at another. None depends on the residual to telemetry either: it says how good the
receiver is, not the model.
"""

from __future__ import annotations

import numpy as np

from nbv.config import MissionConfig
from nbv.errors import MissionFailure
from nbv.gates.base import budget_fraction
from nbv.scorers import box_points
from nbv.scorers.b_aware import mean_neighbour_distance
from nbv.types import PlanningState

FEATURE_NAMES = (
    "f_b",  # adaptive captures used over the adaptive budget
    "n_visited",  # captures so far, seeds included
    "registered_fraction",  # registered cameras over captures
    "d95_m",  # 95th-percentile KNN distance of the sparse cloud
    "box_points",  # tracked points in the box
    "mean_spacing_m",  # mean distance to the nearest neighbours in the box
    "p95_spacing_m",
    "mean_track_length",
    "median_track_length",
    "fraction_weak_tracks",  # tracks shorter than b_aware.target_track_length
    "fraction_two_view",  # tracks of length 2
    "mean_reprojection_px",
    "p95_reprojection_px",
)


def gate_features(state: PlanningState, config: MissionConfig) -> dict[str, float]:
    """The features of one state, by `FEATURE_NAMES`."""
    box = box_points(state.model, config)
    if len(box.points_m) == 0:
        raise MissionFailure(
            "no_points_in_box", f"iteration {state.iteration}: no tracked point near the target"
        )
    lengths = box.track_lengths
    spacing = mean_neighbour_distance(box.points_m, config.b_aware.density_neighbours)
    values = (
        budget_fraction(state),
        len(state.visited_m),
        len(state.model.camera_names) / max(1, len(state.visited_m)),
        state.d95_m,
        len(box.points_m),
        spacing.mean(),
        np.percentile(spacing, 95.0),
        lengths.mean(),
        np.median(lengths),
        np.mean(lengths < config.b_aware.target_track_length),
        np.mean(lengths == 2),
        box.reprojection_error_px.mean(),
        np.percentile(box.reprojection_error_px, 95.0),
    )
    return {name: float(value) for name, value in zip(FEATURE_NAMES, values)}
