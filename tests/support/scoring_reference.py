"""The scorers written plainly, in double precision: what the fast ones must agree with.

`research/scoring_speed.py` compares their times, ``tests/nbv/scorers`` their results.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nbv.config import CameraConfig, MissionConfig
from nbv.geometry.frustum import frustum_planes
from nbv.scorers import box_points
from nbv.scorers.repair import repair
from nbv.scorers.terms import angular_penalty, movement, novelty
from nbv.scorers.weakness import weakness
from nbv.types import CandidatePool, Floats, PlanningState

Mask = NDArray[np.bool_]


def in_frustum(points_m: Floats, positions_m: Floats, target_m: Floats, camera: CameraConfig) -> Mask:
    """(P, C) like `nbv.geometry.frustum.in_frustum`."""
    x, y, z = frustum_planes(positions_m, target_m, camera)
    q = np.column_stack([points_m, np.ones(len(points_m))])
    depth = q @ z
    return (np.abs(q @ x) <= depth) & (np.abs(q @ y) <= depth)


def scores(state: PlanningState, pool: CandidatePool, config: MissionConfig) -> dict[str, Floats]:
    """(C,) scores of both scorers by name."""
    shared, target = config.shared, np.array(config.target_m)
    box = box_points(state.model, config)
    visible = in_frustum(box.points_m, pool.positions_m, target, config.camera)
    nov = novelty(pool.positions_m, state.visited_m, shared.d_scale_m)
    move = movement(
        pool.positions_m,
        pool.headings_rad,
        state.vehicle_position_m,
        state.vehicle_heading_rad,
        shared.d_travel_m,
    )
    ang = angular_penalty(pool.positions_m, state.visited_m, target, shared.theta_min_deg)
    weak = weakness(box.points_m, box.track_lengths, box.reprojection_error_px, config.b_aware)
    main = {
        "covis": visible.mean(axis=0),
        "b-aware": repair(
            visible,
            weak,
            pool.positions_m,
            box,
            config.b_aware.theta_low_deg,
            config.b_aware.theta_saturation_deg,
        ),
    }
    weights = {"covis": config.covis.weights, "b-aware": config.b_aware.weights}
    return {
        name: w.main * main[name] + w.nov * nov - w.move * move - w.ang * ang for name, w in weights.items()
    }


def order(values: Floats) -> NDArray[np.int64]:
    """The candidates by falling score, ties in pool order."""
    return np.argsort(-np.round(values, 12), kind="stable").astype(np.int64)
