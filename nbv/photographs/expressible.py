"""What of a configuration a set of photographs cannot express: refused by name, never ignored."""

from __future__ import annotations

import dataclasses

import numpy as np

from nbv.config import MissionConfig
from nbv.errors import UserError
from nbv.photographs.viewpoints import PhotographViewpoints

# What was as it was when the photographs were taken.
_FIXED = ("scene", "sensor", "ground", "wind", "target", "camera", "target_m")


def require_expressible(config: MissionConfig, name: str, viewpoints: PhotographViewpoints) -> None:
    """`UserError` where ``config`` asks for what the set ``name`` cannot give: other light, wind, ground or optics; seeds or altitudes where nobody photographed."""
    usual = MissionConfig()
    for section in _FIXED:
        asked, default = getattr(config, section), getattr(usual, section)
        if asked == default:
            continue
        paths = [section]
        if dataclasses.is_dataclass(asked):
            paths = [
                f"{section}.{f.name}"
                for f in dataclasses.fields(asked)
                if getattr(asked, f.name) != getattr(default, f.name)
            ]
        condition = "" if config.condition == usual.condition else f" (condition {config.condition})"
        raise UserError(
            f"{name} is a set of photographs that were taken as they were: it cannot express {', '.join(paths)}{condition}; "
            "leave that out"
        )
    viewpoints.seeds(config)
    if not config.adaptive_budget:
        return
    allowed = int(viewpoints.within_altitudes.sum())
    if allowed < config.seed.total + config.adaptive_budget and allowed < len(viewpoints.positions_m) / 4:
        elevations_deg = np.sort(viewpoints.elevations_deg)
        raise UserError(
            f"pool.min_altitude_m {config.pool.min_altitude_m:g} and pool.max_altitude_m {config.pool.max_altitude_m:g} "
            f"are elevations of {viewpoints.lowest_deg:.0f} to {viewpoints.highest_deg:.0f} degrees about the object, "
            f"where {name} has {allowed} photographs to choose from: half of its photographs lie between "
            f"{elevations_deg[len(elevations_deg) // 4]:.0f} and {elevations_deg[3 * len(elevations_deg) // 4]:.0f} "
            "degrees; widen them"
        )
