"""The Gaussian process over configurations: what the missions so far say about every configuration.

Names are loaded when they are asked for: what only names a setting need not wait for torch.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tuner.surrogate.forward_check import Calibration, calibration
    from tuner.surrogate.model import RockMeanGP
    from tuner.surrogate.posterior import Posterior
    from tuner.surrogate.settings import SurrogateSettings, surrogate_settings

__all__ = [
    "Calibration",
    "Posterior",
    "RockMeanGP",
    "SurrogateSettings",
    "calibration",
    "surrogate_settings",
]
_FILES = {
    "Calibration": "forward_check",
    "Posterior": "posterior",
    "RockMeanGP": "model",
    "SurrogateSettings": "settings",
    "calibration": "forward_check",
    "surrogate_settings": "settings",
}


def __getattr__(name: str) -> Any:
    if name not in _FILES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_FILES[name]}"), name)
