"""Eq. 1: what a scorer is, the complete ranking that it makes of a pool, and what all scorers share (Eq. 2 to 4)."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy

from nbv.config import MissionConfig, Weights
from nbv.errors import MissionFailure
from nbv.geometry.frames import directions_from, wrap_angle
from nbv.geometry.visibility import in_frustum
from nbv.process import keyed_rng
from nbv.scorers.prediction import Prediction
from nbv.types import Bools, CandidatePool, Floats, Ints, PlanningState, Ranking, SparseModel


@dataclass(frozen=True)
class SharedTerms:
    """What all scorers need of one state and pool, computed once."""

    model: SparseModel
    box: SparseModel  # its tracked points in the box
    visible: Bools  # (P, C) which of these points each candidate sees
    visited_m: Floats  # (V, 3)
    nov: Floats  # (C,)
    move: Floats  # (C,)
    ang: Floats  # (C,)
    prediction: Prediction | None  # of the dense cloud, where the planner has made one
    left: int = 1  # photographs that may still be taken

    @property
    def rng(self) -> np.random.Generator:
        """A generator that depends on the state alone, so that a mission can be repeated."""
        return keyed_rng("scorer", hashlib.sha256(self.box.points_m.tobytes()).hexdigest())


@dataclass(frozen=True)
class Scorer:
    """A main term of its own with its weights; novelty, movement and angular penalty are shared.

    Parameters
    ----------
    name
        In `nbv.config.names`, in rankings and traces, and as ``gate.kind``.
    main_term
        From the shared terms, the pool and the configuration: (C,), in [0, 1] for weights to mean the same.
    weights
        Which of the configuration's weights are the scorer's.
    settings
        A frozen dataclass of the settings that a plug-in declares; ``config.NAME`` has them.
    """

    name: str
    main_term: Callable[[SharedTerms, CandidatePool, MissionConfig], Floats]
    weights: Callable[[MissionConfig], Weights]
    settings: type | None = None

    def rank(self, terms: SharedTerms, pool: CandidatePool, config: MissionConfig) -> Ranking:
        """All candidates by decreasing S(c) (Eq. 1); ties keep pool order."""
        main, w = self.main_term(terms, pool, config), self.weights(config)
        scores = w.main * main + w.nov * terms.nov - w.move * terms.move - w.ang * terms.ang
        unweighted = {"main": main, "nov": terms.nov, "move": terms.move, "ang": terms.ang}
        return Ranking(self.name, argsort_descending(scores), scores, unweighted)


def argsort_descending(scores: Floats) -> Ints:
    """(C,) candidates, best first; ties keep pool order. `MissionFailure` where a score is NaN or infinite, as a plug-in's may be."""
    if not np.isfinite(scores).all():
        raise MissionFailure(
            "scores_not_finite", "a scorer or gate gave a candidate the score NaN or infinity"
        )
    # Symmetric candidates tie up to rounding, which differs between processors: 1e-12 is no preference.
    return np.argsort(-np.round(scores, 12), kind="stable").astype(np.int64)


def shared_terms(
    state: PlanningState,
    pool: CandidatePool,
    config: MissionConfig,
    prediction: Prediction | None = None,
) -> SharedTerms:
    """What all scorers need of the C candidates: box points, their visibility, and Eq. 2 to 4.

    ``prediction`` is passed on to the scorer *predicted*. `MissionFailure` ``no_points_in_box`` where no sparse point lies
    near the target.
    """
    shared, target = config.shared, np.array(config.target_m)
    box = box_points(state.model, config)
    if len(box.points_m) == 0:
        raise MissionFailure(
            "no_points_in_box",
            f"iteration {state.iteration}: none of {len(state.model.points_m)} sparse points lies within"
            f" {shared.box_half_extent_m} m of the target with {shared.min_track_length} or more views",
        )
    return SharedTerms(
        model=state.model,
        box=box,
        visible=in_frustum(box.points_m, pool.positions_m, target, config.camera),
        visited_m=state.visited_m,
        nov=novelty(pool.positions_m, state.visited_m, shared.d_scale_m),
        move=movement(pool, state, shared.d_travel_m),
        ang=angular_penalty(pool.positions_m, state.visited_m, target, shared.theta_min_deg),
        prediction=prediction,
        left=state.planned_views - state.captures_used,
    )


def box_points(model: SparseModel, config: MissionConfig) -> SparseModel:
    """The point set of Eq. 5 and 8: within ``shared.box_half_extent_m`` of the target on every axis, tracked long enough."""
    offset = np.abs(model.points_m - config.target_m)
    near = np.maximum(np.maximum(offset[:, 0], offset[:, 1]), offset[:, 2]) <= config.shared.box_half_extent_m
    return model.select(np.flatnonzero(near & (model.track_lengths >= config.shared.min_track_length)))


def novelty(candidates_m: Floats, visited_m: Floats, d_scale_m: float) -> Floats:
    """Eq. 2: (C,) distance to the nearest visited viewpoint over ``d_scale_m``, at most 1.

    ``visited_m`` (V, 3) counts seeds and adaptive captures; with none visited everything is new (1).
    """
    if len(visited_m) == 0:
        return np.ones(len(candidates_m))
    return np.minimum(1.0, scipy.spatial.distance.cdist(candidates_m, visited_m).min(axis=1) / d_scale_m)


def movement(pool: CandidatePool, state: PlanningState, d_travel_m: float) -> Floats:
    """Eq. 3: (C,) straight-line travel (0.7 for ``d_travel_m``) and heading change from the vehicle's pose; unbounded."""
    travel = np.linalg.norm(pool.positions_m - state.vehicle_position_m, axis=1)
    turn = np.abs(wrap_angle(pool.headings_rad - state.vehicle_heading_rad))
    return 0.7 * travel / d_travel_m + 0.3 * turn / np.pi


def angular_penalty(
    candidates_m: Floats, visited_m: Floats, target_m: Floats, theta_min_deg: float
) -> Floats:
    """Eq. 4: (C,) 1 for a viewing direction already visited (V, 3), falling to 0 at ``theta_min_deg``.

    A viewing direction is the unit vector from a viewpoint towards the target.
    """
    if len(visited_m) == 0:
        return np.zeros(len(candidates_m))
    # Through the chord: an arc cosine loses half its digits where directions coincide.
    ways = (directions_from(places_m, target_m) for places_m in (candidates_m, visited_m))
    chord = scipy.spatial.distance.cdist(*ways).min(axis=1)
    angle = 2.0 * np.arcsin(np.minimum(1.0, chord / 2.0))
    return np.maximum(0.0, 1.0 - angle / np.deg2rad(theta_min_deg))
