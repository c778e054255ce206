"""Time of scoring one pool: both scorers, 163 candidates, 10,000 points in the box, on one core.

    OMP_NUM_THREADS=1 python -m research.scoring_speed [--points 10000] [--repeats 20]

The state is synthetic but shaped like a real one: a rock of 0.6 to 0.8 m half-axes and the ground around
it, 40 cameras, each point observed by the cameras that see it from a contiguous arc (mean track about 5).
Prints wall and CPU time of each stage, and how much faster the scorers are than written plainly in double
precision (`tests/support/scoring_reference.py`), measured by turns in the same run.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from nbv.config import MissionConfig
from nbv.geometry.frustum import in_frustum
from nbv.scorers import rank_candidates, shared_terms
from nbv.scorers.repair_single import repair_single
from nbv.scorers.weakness import weakness
from nbv.viewpoints import candidate_pool

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests/support"))

import scoring_reference
from scoring_state import synthetic_state


def measure(
    name: str, call: Callable[[], Any], repeats: int, against: Callable[[], Any] | None = None
) -> None:
    """Print wall and CPU time of ``call``: they differ where other work shares the cores.

    With ``against``, both are called by turns and the ratio of the CPU times is printed too.
    """
    calls = [call] if against is None else [call, against]
    wall: list[list[float]] = [[] for _ in calls]
    cpu: list[list[float]] = [[] for _ in calls]
    for one in calls:
        one()
    for _ in range(repeats):
        for i, one in enumerate(calls):
            started, cpu_started = time.perf_counter(), time.process_time()
            one()
            wall[i].append((time.perf_counter() - started) * 1e3)
            cpu[i].append((time.process_time() - cpu_started) * 1e3)
    line = (
        f"{name:36s} wall: median {statistics.median(wall[0]):8.2f} ms, min {min(wall[0]):8.2f} ms"
        f"   CPU: median {statistics.median(cpu[0]):8.2f} ms, min {min(cpu[0]):8.2f} ms"
    )
    if against is not None:
        line += (
            f"   plainly: CPU median {statistics.median(cpu[1]):8.2f} ms,"
            f" {statistics.median(cpu[1]) / statistics.median(cpu[0]):.1f} times as long"
        )
    print(line)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--points", type=int, nargs="+", default=[10_000, 2_000])
    parser.add_argument("--repeats", type=int, default=20)
    arguments = parser.parse_args()
    with threadpool_limits(1):
        for points in arguments.points:
            report(points, arguments.repeats)


def report(points: int, repeats: int) -> None:
    """Time everything on a state of so many points."""
    config = MissionConfig()
    state, pool = synthetic_state(points, config)
    terms = shared_terms(state, pool, config)
    box = terms.ordered
    print(f"{len(pool)} candidates x {len(box.points_m)} points, mean track {box.track_lengths.mean():.2f}")
    weak = weakness(box.points_m, box.track_lengths, box.reprojection_error_px, config.b_aware)
    measure(
        "candidate pool",
        lambda: candidate_pool(config, state.vehicle_position_m, state.visited_m[24:]),
        repeats,
    )
    measure(
        "  frustum",
        lambda: in_frustum(box.points_m, pool.positions_m, np.array(config.target_m), config.camera),
        repeats,
    )
    # The distances are remembered from the stopping rule, as in a mission.
    measure(
        "  weakness",
        lambda: weakness(box.points_m, box.track_lengths, box.reprojection_error_px, config.b_aware),
        repeats,
    )
    measure(
        "  gain and repair",
        lambda: repair_single(terms.visible, weak, pool.positions_m, terms.box, terms.order, 5.0, 25.0),
        repeats,
    )
    for mode, n in (("frustum", repeats), ("occlusion", max(3, repeats // 4))):
        seen = config.with_values({"visibility.mode": mode})
        measure(
            f"both scorers, {mode}",
            lambda seen=seen: rank_candidates(state, pool, seen),
            n,  # type: ignore[misc]
            lambda seen=seen: scoring_reference.scores(state, pool, seen),
        )  # type: ignore[misc]


if __name__ == "__main__":
    main()
