"""What a planner used at one iteration, saved, so that it can be explained later."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from nbv.errors import UserError
from nbv.safe_files import read_npz
from nbv.types import CandidatePool, PlanningState, SparseModel

_MODEL_ARRAYS = ("points_m", "reprojection_error_px", "track_offsets", "track_cameras", "camera_centers_m")
_PLACES = ("points_m", "camera_centers_m", "visited_m", "vehicle_m", "pool_positions_m")
_FARTHEST_M = 1e5
_MOST_CAPTURES = 10_000
_ARRAYS = {  # kinds of dtype and dimensions
    "points_m": ("f", 2),
    "reprojection_error_px": ("f", 1),
    "track_offsets": ("iu", 1),
    "track_cameras": ("iu", 1),
    "camera_centers_m": ("f", 2),
    "camera_names": ("U", 1),
    "alignment_m": ("f", 1),
    "visited_m": ("f", 2),
    "vehicle_m": ("f", 1),
    "scalars": ("f", 1),
    "pool_ids": ("U", 1),
    "pool_positions_m": ("f", 2),
    "pool_headings_rad": ("f", 1),
    "pool_azimuths_deg": ("f", 1),
    "pool_elevations_deg": ("f", 1),
    "pool_bands": ("U", 1),
}


def save_state(path: Path, state: PlanningState, pool: CandidatePool) -> None:
    """Write one compressed ``.npz``."""
    model = state.model
    np.savez_compressed(
        path,
        **{name: getattr(model, name) for name in _MODEL_ARRAYS},
        camera_names=np.array(model.camera_names),
        alignment_m=np.array([model.alignment_rms_m, model.alignment_max_m]),
        visited_m=state.visited_m,
        vehicle_m=state.vehicle_position_m,
        scalars=np.array(
            [
                state.n_seeds,
                state.vehicle_heading_rad,
                state.captures_used,
                state.adaptive_budget,
                state.d95_m,
                state.iteration,
            ]
        ),
        pool_ids=np.array(pool.ids),
        pool_positions_m=pool.positions_m,
        pool_headings_rad=pool.headings_rad,
        pool_azimuths_deg=pool.azimuths_deg,
        pool_elevations_deg=pool.elevations_deg,
        pool_bands=np.array(pool.bands),
    )


def load_state(path: Path) -> tuple[PlanningState, CandidatePool]:
    """Read what ``save_state`` wrote.

    Raises
    ------
    UserError
        The file is missing or is not a planning state; as `nbv.safe_files.read_npz`.
    """
    data = read_npz(path, _ARRAYS)
    _check(data, path)
    model = SparseModel(
        **{name: data[name] for name in _MODEL_ARRAYS},
        camera_names=tuple(data["camera_names"].tolist()),
        alignment_rms_m=float(data["alignment_m"][0]),
        alignment_max_m=float(data["alignment_m"][1]),
    )
    n_seeds, heading, used, budget, d95, iteration = data["scalars"].tolist()
    state = PlanningState(
        model,
        data["visited_m"],
        int(n_seeds),
        data["vehicle_m"],
        heading,
        int(used),
        int(budget),
        d95,
        int(iteration),
    )
    pool = CandidatePool(
        tuple(data["pool_ids"].tolist()),
        data["pool_positions_m"],
        data["pool_headings_rad"],
        data["pool_azimuths_deg"],
        data["pool_elevations_deg"],
        tuple(data["pool_bands"].tolist()),
    )
    return state, pool


def _check(data: dict[str, np.ndarray], path: Path) -> None:
    """That the arrays fit each other: what scores them goes into compiled code with their indices."""
    points, cameras, offsets = len(data["points_m"]), len(data["camera_names"]), data["track_offsets"]
    visited, pool = len(data["visited_m"]), len(data["pool_ids"])
    n_seeds, *counts = data["scalars"][[0, 2, 3, 5]] if len(data["scalars"]) == 6 else (np.nan,)
    shapes: dict[str, tuple[int, ...]] = {
        "points_m": (points, 3),
        "reprojection_error_px": (points,),
        "track_offsets": (points + 1,),
        "camera_centers_m": (cameras, 3),
        "alignment_m": (2,),
        "visited_m": (visited, 3),
        "vehicle_m": (3,),
        "scalars": (6,),
        "pool_positions_m": (pool, 3),
        **dict.fromkeys(
            ("pool_headings_rad", "pool_azimuths_deg", "pool_elevations_deg", "pool_bands"), (pool,)
        ),
    }
    wrong = [name for name, shape in shapes.items() if data[name].shape != shape]
    wrong += [n for n in _PLACES if not np.all(np.abs(data[n]) < _FARTHEST_M)]  # no NaN either
    if not wrong:
        tracks = data["track_cameras"]
        if offsets[0] != 0 or offsets[-1] != len(tracks) or np.any(np.diff(offsets) < 0):
            wrong.append("track_offsets")
        if len(tracks) and not 0 <= tracks.min() <= tracks.max() < cameras:
            wrong.append("track_cameras")
        if not (0 <= n_seeds <= visited and all(0 <= count < _MOST_CAPTURES for count in counts)):
            wrong.append("scalars")
    if wrong:
        raise UserError(
            f"{path} is not a planning state: {wrong[0]} does not fit; name one that a mission saved"
        )
