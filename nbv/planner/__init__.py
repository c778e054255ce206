"""What a companion computer runs: candidates, scorers, gate and stop of Phase 2, and nothing that simulates.

Loads neither Open3D, pyrender nor torch. The mission loop plans with it, too.
"""

from nbv.planner.planner import Plan, Planner

__all__ = ["Plan", "Planner"]
