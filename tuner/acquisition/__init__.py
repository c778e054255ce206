"""What to fly next: the acquisition function and its maximum.

Names are loaded when they are asked for: what only names a setting need not wait for torch.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import lazy_loader

if TYPE_CHECKING:
    from tuner.acquisition.front import flown_in_both, propose_for_front, two_models
    from tuner.acquisition.propose import maximise
    from tuner.acquisition.within import Within, propose_within

__all__ = [
    "Within",
    "flown_in_both",
    "maximise",
    "propose_for_front",
    "propose_within",
    "two_models",
]
__getattr__, __dir__, _ = lazy_loader.attach(
    __name__,
    submod_attrs={
        "within": ["Within", "propose_within"],
        "propose": ["maximise"],
        "front": ["flown_in_both", "propose_for_front", "two_models"],
    },
)
