"""What to fly next: the acquisition function and its maximum.

Names are loaded when they are asked for: what only names a setting need not wait for torch.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import lazy_loader

if TYPE_CHECKING:
    from tuner.acquisition.constrained import Constraint, propose_constrained
    from tuner.acquisition.front import flown_in_both, propose_for_front, two_models
    from tuner.acquisition.propose import maximise

__all__ = [
    "Constraint",
    "flown_in_both",
    "maximise",
    "propose_constrained",
    "propose_for_front",
    "two_models",
]
__getattr__, __dir__, _ = lazy_loader.attach(
    __name__,
    submod_attrs={
        "constrained": ["Constraint", "propose_constrained"],
        "propose": ["maximise"],
        "front": ["flown_in_both", "propose_for_front", "two_models"],
    },
)
