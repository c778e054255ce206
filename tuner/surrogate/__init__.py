"""The Gaussian process over configurations: what the missions so far say about every configuration.

Names are loaded when they are asked for: what only names a setting need not wait for torch.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import lazy_loader

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
__getattr__, __dir__, _ = lazy_loader.attach(
    __name__,
    submod_attrs={
        "forward_check": ["Calibration", "calibration"],
        "posterior": ["Posterior"],
        "model": ["RockMeanGP"],
        "settings": ["SurrogateSettings", "surrogate_settings"],
    },
)
