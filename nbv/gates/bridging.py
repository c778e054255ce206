"""Bridging: a view between the photographs that are registered and those that are not, so that these join the model."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from nbv.config import MissionConfig
from nbv.gates.base import ranking_of
from nbv.geometry.frames import angles_deg
from nbv.scorers.registration import registration_chance, unregistered_m
from nbv.types import (
    CandidatePool,
    Capture,
    Floats,
    GateDecision,
    PlanningState,
    Ranking,
    SparseModel,
    Viewpoint,
)

_LEAST_ADVANCE_DEG = 4.0  # nearer than that a registered photograph is no help, or it is there already


def bridge(
    state: PlanningState, pool: CandidatePool, rankings: dict[str, Ranking], config: MissionConfig
) -> GateDecision | None:
    """The decision to bridge; None where enough photographs are registered or no candidate brings the others nearer.

    A candidate is worth the angle by which it lies nearer to each unregistered photograph than any registered one, as seen
    from the target, times its own chance to register.
    """
    lost_m = unregistered_m(state)
    share = 1.0 - len(lost_m) / max(1, len(state.visited_m))
    if len(lost_m) == 0 or share >= config.gate.bridge_below:
        return None
    nearest_deg = _apart_deg(lost_m, state.model.camera_centers_m, config).min(axis=1, keepdims=True)
    nearer_deg = np.maximum(0.0, nearest_deg - _apart_deg(lost_m, pool.positions_m, config)).sum(axis=0)
    worth = nearer_deg * registration_chance(state.model, pool.positions_m, config)
    if worth.max() < _LEAST_ADVANCE_DEG:
        return None
    reason = f"{len(lost_m)} of {len(state.visited_m)} photographs are not registered: a view between"
    return GateDecision(ranking_of("bridge", worth, rankings), reason, {"registered_share": share})


def next_between(
    views: Sequence[Viewpoint], seeds: Sequence[Capture], model: SparseModel, config: MissionConfig
) -> Viewpoint | None:
    """Of ``views`` that lie nearer to a missing seed than every registered camera does, the one nearest to a registered camera."""
    missing_m = [c.viewpoint.position_m for c in seeds if c.name not in model.camera_names]
    if not missing_m or not views:
        return None
    views_m = np.array([view.position_m for view in views])
    nearest_deg = _apart_deg(np.array(missing_m), model.camera_centers_m, config).min(axis=1, keepdims=True)
    nearer = (_apart_deg(np.array(missing_m), views_m, config) < nearest_deg - _LEAST_ADVANCE_DEG).any(axis=0)
    reach_deg = np.where(nearer, _apart_deg(views_m, model.camera_centers_m, config).min(axis=1), np.inf)
    best = int(reach_deg.round(6).argmin())
    return views[best] if nearer[best] else None


def _apart_deg(a_m: Floats, b_m: Floats, config: MissionConfig) -> Floats:
    """(A, B) degrees between places (A, 3) and (B, 3), seen from the target."""
    target = np.array(config.target_m)
    a, b = (d / np.linalg.norm(d, axis=1, keepdims=True) for d in (a_m - target, b_m - target))
    return angles_deg(a, b)
