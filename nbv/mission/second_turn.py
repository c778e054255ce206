"""Further seeds between the registered photographs and those that are not, so that these join the model (`seed.second_turn`)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from nbv.config import MissionConfig
from nbv.geometry.frames import angles_deg, directions_from
from nbv.types import Capture, Floats, SparseModel, Viewpoint

_LEAST_ADVANCE_DEG = 4.0  # nearer than that a registered photograph is no help, or it is there already


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
    return angles_deg(directions_from(config.target_m, a_m), directions_from(config.target_m, b_m))
