"""What to fly next: the acquisition function and its maximum.

Names are loaded when they are asked for: what only names a setting need not wait for torch.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tuner.acquisition.front import propose_for_front
    from tuner.acquisition.propose import maximise

__all__ = [
    "maximise",
    "propose_for_front",
]
_FILES = {
    "maximise": "propose",
    "propose_for_front": "front",
}


def __getattr__(name: str) -> Any:
    if name not in _FILES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_FILES[name]}"), name)
