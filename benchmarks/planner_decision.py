"""CPU time of one decision of `nbv.Planner`: 10,000 points, 163 candidates, both of the paper's scorers.

OMP_NUM_THREADS=1 python benchmarks/planner_decision.py
"""

from __future__ import annotations

import time

import numpy as np

import nbv
from nbv.config import preset
from nbv.types import SparseModel
from nbv.viewpoints import seed_viewpoints

POINTS, TRACK, REPEATS = 10_000, 5, 50


def main() -> None:
    """Print the median and the slowest of the decisions, after one that warms up."""
    config = preset("paper")
    rng = np.random.default_rng(0)
    cameras = np.array([view.position_m for view in seed_viewpoints(config)])
    tracks = np.sort(np.argsort(rng.random((POINTS, len(cameras))), axis=1)[:, :TRACK], axis=1)
    model = SparseModel(
        rng.normal(config.target_m, 0.4, (POINTS, 3)),
        rng.uniform(0.2, 1.0, POINTS),
        np.arange(0, POINTS * TRACK + 1, TRACK),
        tracks.ravel(),
        cameras,
        tuple(f"seed_{i:02d}" for i in range(len(cameras))),
        0.0,
        0.0,
    )
    planner = nbv.Planner(config)
    seconds = []
    for i in range(REPEATS + 1):
        moved = SparseModel(model.points_m + 1e-9 * i, *[getattr(model, f) for f in list(vars(model))[1:]])
        started = time.process_time()
        plan = planner.plan(moved, cameras, len(cameras), cameras[-1], 0.0)
        seconds.append(time.process_time() - started)
    assert plan.pool is not None
    taken = 1e3 * np.array(seconds[1:])
    print(
        f"{len(plan.pool)} candidates, {POINTS} points: median {np.median(taken):.1f} ms, slowest {taken.max():.1f} ms"
    )


if __name__ == "__main__":
    main()
