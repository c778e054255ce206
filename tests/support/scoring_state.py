"""Sparse models, pools and planning states for tests of what reads them."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from nbv.geometry.frames import heading_to
from nbv.types import CandidatePool, SparseModel


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


def few_seeds(count: int, **seed: Any) -> dict[str, Any]:
    """Values of a mission whose seeds fly one turn and are held together by features of the ground."""
    turn = {f"seed.{name}": value for name, value in {"layout": "turn", **seed}.items()}
    return {"seeds": count, "sparse.ground_features": 2000, "sparse.min_registered_seeds": 6, **turn}
