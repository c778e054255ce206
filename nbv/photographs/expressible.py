"""What of a configuration a set of photographs cannot express: refused by name, never ignored."""

from __future__ import annotations

import dataclasses

from nbv.config import MissionConfig
from nbv.errors import UserError

# What was as it was when the photographs were taken.
_FIXED = ("scene", "sensor", "ground", "wind", "target", "camera", "target_m")


def require_expressible(config: MissionConfig, name: str) -> None:
    """`UserError` where ``config`` asks for what no set, such as ``name``, can give: other light, wind, ground or optics."""
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
