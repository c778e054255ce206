"""Time of scoring one pool: both scorers, 163 candidates, 10,000 points in the box, on one core.

    OMP_NUM_THREADS=1 python benchmarks/scoring_speed.py [--points 10000] [--repeats 20]

The state is synthetic but shaped like a real one: a rock of 0.6 to 0.8 m half-axes and the ground around
it, 40 cameras, each point observed by the cameras that see it from a contiguous arc (mean track about 5).
Prints wall and CPU time of each stage, and how much faster the scorers are than written plainly in double
precision (`benchmarks/scoring_reference.py`), measured by turns in the same run.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import scoring_reference
from threadpoolctl import threadpool_limits

from nbv.config import MissionConfig
from nbv.geometry.frustum import in_frustum
from nbv.scorers import rank_candidates, shared_terms
from nbv.scorers.repair_single import repair_single
from nbv.scorers.weakness import weakness
from nbv.types import CandidatePool, PlanningState, SparseModel
from nbv.viewpoints import candidate_pool, raw_candidates, seed_viewpoints


def synthetic_state(
    n_points: int, config: MissionConfig, seed: int = 0
) -> tuple[PlanningState, CandidatePool]:
    """A state with ``n_points`` tracked points in the box, and the first pool after the seeds."""
    rng = np.random.default_rng(seed)
    n_rock = n_points // 4
    direction = rng.normal(size=(n_rock, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    rock = direction * [0.7, 0.6, 0.78] + [0, 0, 0.8]
    ground = np.column_stack([rng.uniform(-2, 2, (n_points - n_rock, 2)), np.zeros(n_points - n_rock)])
    points = np.concatenate([rock, ground]) + rng.normal(0, 0.005, (n_points, 3))
    points = np.clip(points, np.array(config.target_m) - 1.99, np.array(config.target_m) + 1.99)

    raw = raw_candidates(config)
    adaptive = [raw[i] for i in rng.permutation(len(raw))[:16]]
    cameras = np.array([v.position_m for v in [*seed_viewpoints(config), *adaptive]])
    outward = np.concatenate([direction, np.tile([0.0, 0.0, 1.0], (n_points - n_rock, 1))])
    lengths = np.clip(rng.geometric(0.22, n_points) + 1, 2, 25)
    tracks = []
    for p, n, k in zip(points, outward, lengths):
        ray = cameras - p
        ray /= np.linalg.norm(ray, axis=1, keepdims=True)
        seen = np.flatnonzero(ray @ n > 0.1)
        if len(seen) < 2:
            seen = np.argsort(-(ray @ n))[:2]
        anchor = ray[rng.choice(seen)]
        tracks.append(np.sort(seen[np.argsort(-(ray[seen] @ anchor))[:k]]))
    model = SparseModel(
        points_m=points,
        reprojection_error_px=rng.gamma(2.0, 0.25, n_points),
        track_offsets=np.concatenate([[0], np.cumsum([len(t) for t in tracks])]).astype(np.int64),
        track_cameras=np.concatenate(tracks).astype(np.int64),
        camera_centers_m=cameras,
        camera_names=tuple(f"{i}.png" for i in range(len(cameras))),
        alignment_rms_m=0.005,
        alignment_max_m=0.01,
    )
    vehicle = cameras[-1]
    state = PlanningState(model, cameras, 24, vehicle, 0.0, 16, 40, 0.1, 16)
    return state, candidate_pool(config, vehicle, np.zeros((0, 3)))


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
        lambda: repair_single(
            terms.visible,
            weak,
            pool.positions_m,
            box.points_m,
            box.track_offsets[:-1],
            box.track_lengths,
            box.track_cameras,
            box.camera_centers_m,
            5.0,
            25.0,
        ),
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
