"""Everything that proposes missions, behind one protocol.

Names are loaded when they are asked for: what only names a setting need not wait for torch.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import lazy_loader

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
__getattr__, __dir__, _ = lazy_loader.attach(
    __name__,
    submod_attrs={
        "earlier_missions": ["EarlierMissions"],
        "base": ["Sampler", "SamplerSettings"],
        "registry": ["make_sampler"],
    },
)
