"""Sparse models, pools and planning states for tests of what reads them."""

from collections.abc import Sequence

import numpy as np

from nbv.config import MissionConfig
from nbv.geometry.frames import heading_to
from nbv.types import CandidatePool, PlanningState, SparseModel
from nbv.viewpoints import candidate_pool, raw_candidates, seed_viewpoints


def sparse_model(
    points_m: np.ndarray,
    tracks: Sequence[Sequence[int] | np.ndarray],
    cameras_m: np.ndarray,
    error_px: np.ndarray | None = None,
) -> SparseModel:
    """Points with the numbers of the cameras that see each; ``error_px`` is 1 where it is not given."""
    return SparseModel(
        points_m=points_m,
        reprojection_error_px=np.ones(len(points_m)) if error_px is None else error_px,
        track_offsets=np.concatenate([[0], np.cumsum([len(t) for t in tracks])]).astype(np.int64),
        track_cameras=np.concatenate([*tracks, []]).astype(np.int64),
        camera_centers_m=cameras_m,
        camera_names=tuple(f"{i}.png" for i in range(len(cameras_m))),
        alignment_rms_m=0.005,
        alignment_max_m=0.01,
    )


def pool_at(positions_m: np.ndarray, target_m: np.ndarray) -> CandidatePool:
    """Candidates that look at the target, ``cand_000`` and on."""
    n = len(positions_m)
    return CandidatePool(
        ids=tuple(f"cand_{i:03d}" for i in range(n)),
        positions_m=positions_m,
        headings_rad=heading_to(positions_m, target_m),
        azimuths_deg=np.zeros(n),
        elevations_deg=np.zeros(n),
        bands=("lateral",) * n,
    )


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
    model = sparse_model(points, tracks, cameras, rng.gamma(2.0, 0.25, n_points))
    vehicle = cameras[-1]
    state = PlanningState(model, cameras, 24, vehicle, 0.0, 16, 40, 0.1, 16)
    return state, candidate_pool(config, vehicle, np.zeros((0, 3)))
