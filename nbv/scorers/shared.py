"""What all scorers share of one state and pool: points in the box, visibility, Eq. 2 to 4."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from nbv.config import MissionConfig
from nbv.errors import MissionFailure
from nbv.geometry.frustum import in_frustum
from nbv.scorers.box import BoxPoints, box_points
from nbv.scorers.terms import angular_penalty, movement, novelty
from nbv.types import Bools, CandidatePool, Floats, Ints, PlanningState


@dataclass(frozen=True)
class SharedTerms:
    """What both scorers need of one state and pool, computed once."""

    box: BoxPoints  # in the model's order, which the memory of neighbour distances knows
    order: Ints  # (P,) the same points, longest track first
    points_m: Floats  # (P, 3) box.points_m[order]
    visible: Bools  # (P, C) rows as in ``points_m``
    visited_m: Floats  # (V, 3)
    nov: Floats  # (C,)
    move: Floats  # (C,)
    ang: Floats  # (C,)

    @cached_property
    def ordered(self) -> BoxPoints:
        """The box points in that order with their tracks; frustum visibility and clear scores do not need them."""
        return self.box.select(self.order)


def shared_terms(state: PlanningState, pool: CandidatePool, config: MissionConfig) -> SharedTerms:
    """Box points, visibility and Eq. 2 to 4.

    Raises
    ------
    MissionFailure
        ``no_points_in_box``: there is nothing to plan from.
    """
    shared, target = config.shared, np.array(config.target_m)
    box = box_points(state.model, config)
    if len(box.points_m) == 0:
        raise MissionFailure(
            "no_points_in_box",
            f"iteration {state.iteration}: none of {len(state.model.points_m)} sparse points lies within"
            f" {shared.box_half_extent_m} m of the target with {shared.min_track_length} or more views",
        )
    order = box.longest_first()
    points = box.points_m[order]
    visible = in_frustum(points, pool.positions_m, target, config.camera)
    return SharedTerms(
        box=box,
        order=order,
        points_m=points,
        visible=visible,
        visited_m=state.visited_m,
        nov=novelty(pool.positions_m, state.visited_m, shared.d_scale_m),
        move=movement(
            pool.positions_m,
            pool.headings_rad,
            state.vehicle_position_m,
            state.vehicle_heading_rad,
            shared.d_travel_m,
        ),
        ang=angular_penalty(pool.positions_m, state.visited_m, target, shared.theta_min_deg),
    )
