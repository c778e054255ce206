"""What all scorers share of one state and pool: points in the box, visibility, Eq. 2 to 4."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from nbv.config import MissionConfig
from nbv.errors import MissionFailure
from nbv.geometry.frustum import in_frustum
from nbv.scorers.occlusion import unoccluded
from nbv.scorers.repair_single import longest_first
from nbv.scorers.terms import angular_penalty, movement, novelty
from nbv.types import CandidatePool, Floats, Ints, PlanningState, SparseModel


@dataclass(frozen=True)
class BoxPoints:
    """The point set of Eq. 5 and 8: tracked points in the box around the target, tracks in CSR form."""

    points_m: Floats  # (P, 3)
    reprojection_error_px: Floats  # (P,)
    track_offsets: Ints  # (P + 1,)
    track_cameras: Ints  # (T,) indices into camera_centers_m
    camera_centers_m: Floats  # (M, 3)

    @property
    def track_lengths(self) -> Ints:
        """(P,) number of observing cameras per point."""
        return np.diff(self.track_offsets)

    def select(self, keep: Ints) -> BoxPoints:
        """The points ``keep``, in that order."""
        lengths = self.track_lengths[keep]
        offsets = np.concatenate([[0], np.cumsum(lengths)]).astype(np.int64)
        # Position of every kept observation in the full list: start of its point's track + rank within it.
        place = np.arange(offsets[-1]) + np.repeat(self.track_offsets[keep] - offsets[:-1], lengths)
        return BoxPoints(
            self.points_m[keep],
            self.reprojection_error_px[keep],
            offsets,
            self.track_cameras[place],
            self.camera_centers_m,
        )


@dataclass(frozen=True)
class SharedTerms:
    """What both scorers need of one state and pool, computed once."""

    box: BoxPoints  # in the model's order, which the memory of neighbour distances knows
    order: Ints  # (P,) the same points, longest track first
    points_m: Floats  # (P, 3) box.points_m[order]
    visible: NDArray[np.bool_]  # (P, C) rows as in ``points_m``
    visited_m: Floats  # (V, 3)
    nov: Floats  # (C,)
    move: Floats  # (C,)
    ang: Floats  # (C,)

    @cached_property
    def ordered(self) -> BoxPoints:
        """The box points in that order with their tracks; frustum visibility and clear scores do not need them."""
        return self.box.select(self.order)


def box_points(model: SparseModel, config: MissionConfig) -> BoxPoints:
    """Points within ``shared.box_half_extent_m`` of the target on every axis, with long enough tracks."""
    offset = np.abs(model.points_m - config.target_m)
    near = np.maximum(np.maximum(offset[:, 0], offset[:, 1]), offset[:, 2]) <= config.shared.box_half_extent_m
    keep = np.flatnonzero(near & (model.track_lengths >= config.shared.min_track_length))
    everything = BoxPoints(
        model.points_m,
        model.reprojection_error_px,
        model.track_offsets,
        model.track_cameras,
        model.camera_centers_m,
    )
    return everything if len(keep) == len(model.points_m) else everything.select(keep)


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
    order = longest_first(box.track_offsets)
    points = box.points_m[order]
    visible = in_frustum(points, pool.positions_m, target, config.camera)
    if config.visibility.mode == "occlusion":
        ordered = box.select(order)
        visible = unoccluded(
            visible,
            ordered.points_m,
            ordered.track_offsets,
            ordered.track_cameras,
            ordered.camera_centers_m,
            pool.positions_m,
        )
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
