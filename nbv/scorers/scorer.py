"""Eq. 1: both scorers' complete rankings of a pool, sharing everything that they can share."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from nbv.config import MissionConfig, Weights
from nbv.errors import MissionFailure
from nbv.geometry.frustum import in_frustum
from nbv.scorers.b_aware import repair, weakness
from nbv.scorers.covis import co_visibility
from nbv.scorers.matchable import matchable_repair, proxy_surface
from nbv.scorers.occlusion import unoccluded
from nbv.scorers.repair_single import longest_first, precision, repair_single
from nbv.scorers.terms import angular_penalty, movement, novelty
from nbv.types import CandidatePool, Floats, Ints, PlanningState, Ranking, SparseModel

MIN_POINTS_SINGLE = 300  # rounding errors of fewer points do not cancel well, and there is little to gain


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
        return BoxPoints(self.points_m[keep], self.reprojection_error_px[keep], offsets,
                         self.track_cameras[place], self.camera_centers_m)  # fmt: skip


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
    everything = BoxPoints(model.points_m, model.reprojection_error_px, model.track_offsets,
                           model.track_cameras, model.camera_centers_m)  # fmt: skip
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
            visible, ordered.points_m, ordered.track_offsets, ordered.track_cameras,
            ordered.camera_centers_m, pool.positions_m,
        )  # fmt: skip
    return SharedTerms(
        box=box,
        order=order,
        points_m=points,
        visible=visible,
        visited_m=state.visited_m,
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
    """Baseline-aware repair (Eq. 6 to 8), or with ``b_aware.main_term=matchable`` our own main term.

    Eq. 8 is worked out in single precision first, and in double precision for the candidates that this
    cannot put in order: the order is that of double precision throughout.

    Raises
    ------
    MissionFailure
        ``no_surface``: our main term, and the points near the target span no volume.
    """
    box, b_aware = terms.box, config.b_aware
    if b_aware.main_term == "matchable":
        surface = proxy_surface(box.points_m, config)
        if surface is None:
            raise MissionFailure(
                "no_surface",
                f"the {len(box.points_m)} sparse points near the target span no volume above the ground;"
                " b_aware.main_term=repair needs none",
            )
        main = matchable_repair(surface, pool.positions_m, terms.visited_m, config)
        return rank("b-aware", main, terms, b_aware.weights)
    lengths = box.track_lengths
    weak = weakness(box.points_m, lengths, box.reprojection_error_px, b_aware)[terms.order]
    angles = (b_aware.theta_low_deg, b_aware.theta_saturation_deg)

    def exactly(columns: slice | Ints) -> Floats:
        ordered = terms.ordered
        return repair(
            terms.visible[:, columns], weak, pool.positions_m[columns], ordered.points_m, ordered.track_offsets,
            ordered.track_cameras, ordered.camera_centers_m, *angles,
        )  # fmt: skip

    error = precision(*angles)
    if len(box.points_m) < MIN_POINTS_SINGLE or not np.isfinite(error):
        return rank("b-aware", exactly(slice(None)), terms, b_aware.weights)
    main = repair_single(
        terms.visible, weak, pool.positions_m, terms.points_m, box.track_offsets[terms.order],
        lengths[terms.order], box.track_cameras, box.camera_centers_m, *angles,
    )  # fmt: skip
    ranking = rank("b-aware", main, terms, b_aware.weights)
    sorted_scores = ranking.scores[ranking.order]
    close = np.abs(np.diff(sorted_scores)) <= 2.0 * error * b_aware.weights.main + 1e-11
    unsettled = ranking.order[np.append(close, False) | np.append(False, close)]
    if len(unsettled) == 0:
        return ranking
    main[unsettled] = exactly(unsettled)
    return rank("b-aware", main, terms, b_aware.weights)


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
