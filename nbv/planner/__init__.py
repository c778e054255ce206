"""The planner by itself: a sparse model and the visited views in, ranked viewpoints and the gate's decision out."""

from nbv.planner.planner import Plan, Planner

__all__ = ["Plan", "Planner"]
