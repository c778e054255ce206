"""One complete next-best-view mission: fly, photograph, reconstruct, plan, measure."""

from typing import TYPE_CHECKING

import lazy_loader

if TYPE_CHECKING:
    from nbv.planner import Plan, Planner

__all__ = ["Plan", "Planner"]
__getattr__, __dir__, _ = lazy_loader.attach(__name__, submod_attrs={"planner": ["Plan", "Planner"]})
