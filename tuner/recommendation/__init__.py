"""Which configuration to use, and which may be recommended at all.

Names are loaded when they are asked for: what only names a setting need not wait for torch.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tuner.recommendation.eligible import may_be_recommended
    from tuner.recommendation.inactive import Inactive, inactive_parameters
    from tuner.recommendation.next_rock import NextRock, next_rock
    from tuner.recommendation.recommendation import Recommendation, recommend
    from tuner.recommendation.sparsest import Sparsest, sparsest

__all__ = [
    "Inactive",
    "NextRock",
    "Recommendation",
    "Sparsest",
    "inactive_parameters",
    "may_be_recommended",
    "next_rock",
    "recommend",
    "sparsest",
]
_FILES = {
    "Inactive": "inactive",
    "NextRock": "next_rock",
    "Recommendation": "recommendation",
    "Sparsest": "sparsest",
    "inactive_parameters": "inactive",
    "may_be_recommended": "eligible",
    "next_rock": "next_rock",
    "recommend": "recommendation",
    "sparsest": "sparsest",
}


def __getattr__(name: str) -> Any:
    if name not in _FILES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_FILES[name]}"), name)
