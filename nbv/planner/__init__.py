"""The planner by itself: a sparse model and the visited views in, ranked viewpoints and the gate's decision out."""

from nbv.planner.planner import Plan, Planner, density_d95_m

__all__ = ["Plan", "Planner", "density_d95_m"]
