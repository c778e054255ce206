"""Eq. 1: both scorers' complete rankings of a pool, sharing everything that they can share."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nbv.config import MissionConfig, Weights
from nbv.errors import MissionFailure
from nbv.scorers.b_aware import repair, weakness
from nbv.scorers.covis import co_visibility
from nbv.scorers.occlusion import unoccluded
from nbv.scorers.terms import angular_penalty, movement, novelty
from nbv.scorers.visibility import in_frustum
from nbv.types import CandidatePool, Floats, Ints, PlanningState, Ranking, SparseModel


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


@dataclass(frozen=True)
class SharedTerms:
    """What both scorers need of one state and pool, computed once."""

    box: BoxPoints
    visible: NDArray[np.bool_]  # (P, C)
    nov: Floats  # (C,)
    move: Floats  # (C,)
    ang: Floats  # (C,)


def box_points(model: SparseModel, config: MissionConfig) -> BoxPoints:
    """Points within ``shared.box_half_extent_m`` of the target on every axis, with long enough tracks."""
    lengths = model.track_lengths
    inside = (np.abs(model.points_m - config.target_m) <= config.shared.box_half_extent_m).all(axis=1)
    keep = np.flatnonzero(inside & (lengths >= config.shared.min_track_length))
    offsets = np.concatenate([[0], np.cumsum(lengths[keep])]).astype(np.int64)
    # Position of every kept observation in the full list: start of its point's track + rank within it.
    rank = np.arange(offsets[-1]) - np.repeat(offsets[:-1], lengths[keep])
    cameras = model.track_cameras[np.repeat(model.track_offsets[keep], lengths[keep]) + rank]
    return BoxPoints(model.points_m[keep], model.reprojection_error_px[keep], offsets,
                     cameras, model.camera_centers_m)  # fmt: skip


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
    visible = in_frustum(box.points_m, pool.positions_m, target, config.camera)
    if config.visibility.mode == "occlusion":
        visible = unoccluded(
            visible, box.points_m, box.track_offsets, box.track_cameras, box.camera_centers_m,
            pool.positions_m,
        )  # fmt: skip
    return SharedTerms(
        box=box,
        visible=visible,
        nov=novelty(pool.positions_m, state.visited_m, shared.d_scale_m),
        move=movement(pool.positions_m, pool.headings_rad, state.vehicle_position_m,
                      state.vehicle_heading_rad, shared.d_travel_m),
        ang=angular_penalty(pool.positions_m, state.visited_m, target, shared.theta_min_deg),
    )  # fmt: skip


def rank(scorer: str, main: Floats, terms: SharedTerms, weights: Weights) -> Ranking:
    """Eq. 1, and the candidates by falling score; ties keep pool order."""
    scores = (
        weights.main * main + weights.nov * terms.nov - weights.move * terms.move - weights.ang * terms.ang
    )
    # Symmetric candidates tie up to rounding, which differs between processors: 1e-12 is no preference.
    order = np.argsort(-np.round(scores, 12), kind="stable").astype(np.int64)
    return Ranking(
        scorer, order, scores, {"main": main, "nov": terms.nov, "move": terms.move, "ang": terms.ang}
    )


def rank_covis(terms: SharedTerms, config: MissionConfig) -> Ranking:
    """Co-visibility (Eq. 5)."""
    return rank("covis", co_visibility(terms.visible), terms, config.covis.weights)


def rank_b_aware(terms: SharedTerms, pool: CandidatePool, config: MissionConfig) -> Ranking:
    """Baseline-aware repair (Eq. 6 to 8)."""
    box = terms.box
    weak = weakness(box.points_m, box.track_lengths, box.reprojection_error_px, config.b_aware)
    main = repair(
        terms.visible, weak, pool.positions_m, box.points_m, box.track_offsets, box.track_cameras,
        box.camera_centers_m, config.b_aware.theta_low_deg, config.b_aware.theta_saturation_deg,
    )  # fmt: skip
    return rank("b-aware", main, terms, config.b_aware.weights)


def rank_candidates(state: PlanningState, pool: CandidatePool, config: MissionConfig) -> dict[str, Ranking]:
    """Both base scorers on the same pool: ``{"covis": ..., "b-aware": ...}``.

    The pool must not be empty; the mission ends before scoring if it is.

    Raises
    ------
    MissionFailure
        ``no_points_in_box``: there is nothing to plan from.
    """
    if len(pool) == 0:
        raise ValueError("rank_candidates: the candidate pool is empty")
    terms = shared_terms(state, pool, config)
    return {"covis": rank_covis(terms, config), "b-aware": rank_b_aware(terms, pool, config)}
