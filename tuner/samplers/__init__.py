"""Everything that proposes missions, behind one protocol.

Names are loaded when they are asked for: what only names a setting need not wait for torch.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tuner.samplers.base import Sampler, SamplerSettings
    from tuner.samplers.earlier_missions import EarlierMissions
    from tuner.samplers.registry import make_sampler

__all__ = [
    "EarlierMissions",
    "Sampler",
    "SamplerSettings",
    "make_sampler",
]
_FILES = {
    "EarlierMissions": "earlier_missions",
    "Sampler": "base",
    "SamplerSettings": "base",
    "make_sampler": "registry",
}


def __getattr__(name: str) -> Any:
    if name not in _FILES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_FILES[name]}"), name)
