"""What to fly next: the acquisition function and its maximum.

Names are loaded when they are asked for: what only names a setting need not wait for torch.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import lazy_loader

if TYPE_CHECKING:
    from tuner.acquisition.constrained import Constraint, propose_constrained
    from tuner.acquisition.two_objectives import flown_in_both, two_models

__all__ = ["Constraint", "flown_in_both", "propose_constrained", "two_models"]
__getattr__, __dir__, _ = lazy_loader.attach(
    __name__,
    submod_attrs={
        "constrained": ["Constraint", "propose_constrained"],
        "two_objectives": ["flown_in_both", "two_models"],
    },
)
