"""What to fly next: the acquisition function and its maximum.

Names are loaded when they are asked for: what only names a setting need not wait for torch.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tuner.acquisition.front import propose_for_front
    from tuner.acquisition.propose import maximise
    from tuner.acquisition.within import Within, propose_within

__all__ = [
    "Within",
    "maximise",
    "propose_for_front",
    "propose_within",
]
_FILES = {
    "Within": "within",
    "maximise": "propose",
    "propose_for_front": "front",
    "propose_within": "within",
}


def __getattr__(name: str) -> Any:
    if name not in _FILES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_FILES[name]}"), name)
