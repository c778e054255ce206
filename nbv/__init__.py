"""One complete next-best-view mission: fly, photograph, reconstruct, plan, measure."""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from nbv.planner import Plan, Planner

__all__ = ["Plan", "Planner"]


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module("nbv.planner"), name)
