"""What a planner used at one iteration, saved, so that it can be explained later."""

from __future__ import annotations

import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from nbv.safe_files import read_npz, write_atomic
from nbv.types import CandidatePool, PlanningState, SparseModel

_ARRAYS = (
    "points_m",
    "reprojection_error_px",
    "track_offsets",
    "track_cameras",
    "camera_centers_m",
    "depth_m",
    "depth_cameras",
)
_SCALARS = ("n_seeds", "vehicle_heading_rad", "captures_used", "planned_views", "d95_m", "iteration")
_POOL = ("ids", "positions_m", "headings_rad", "azimuths_deg", "elevations_deg", "bands")
_STATE = (*_ARRAYS, "camera_names", "alignment_m", "visited_m", "vehicle_m", "scalars")


def arrays_of(model: SparseModel) -> dict[str, np.ndarray]:
    return {
        **{name: getattr(model, name) for name in _ARRAYS},
        "camera_names": np.array(model.camera_names),
        "alignment_m": np.array([model.alignment_rms_m, model.alignment_max_m]),
    }


def model_of(arrays: Mapping[str, np.ndarray]) -> SparseModel:
    """The sparse model that `arrays_of` took apart."""
    return SparseModel(
        **{name: arrays[name] for name in _ARRAYS},
        camera_names=tuple(arrays["camera_names"].tolist()),
        alignment_rms_m=float(arrays["alignment_m"][0]),
        alignment_max_m=float(arrays["alignment_m"][1]),
    )


def save_state(path: Path, state: PlanningState, pool: CandidatePool) -> None:
    buffer = io.BytesIO()
    np.savez_compressed(
        buffer,
        **arrays_of(state.model),  # type: ignore[arg-type]
        visited_m=state.visited_m,
        vehicle_m=state.vehicle_position_m,
        scalars=np.array([getattr(state, name) for name in _SCALARS]),
        **{f"pool_{name}": np.asarray(getattr(pool, name)) for name in _POOL},  # type: ignore[arg-type]
    )
    write_atomic(path, buffer.getbuffer())


def load_state(path: Path) -> tuple[PlanningState, CandidatePool]:
    """Read what ``save_state`` wrote.

    `UserError` where the file is missing or is not a planning state; as `nbv.safe_files.read_npz`.
    """
    data = read_npz(path, (*_STATE, *(f"pool_{name}" for name in _POOL)))
    scalars = dict(zip(_SCALARS, data["scalars"].tolist()))
    counts = {name: int(scalars[name]) for name in scalars if name not in ("vehicle_heading_rad", "d95_m")}
    state = PlanningState(
        model=model_of(data),
        visited_m=data["visited_m"],
        vehicle_position_m=data["vehicle_m"],
        **{**scalars, **counts},
    )
    pool: dict[str, Any] = {name: data[f"pool_{name}"] for name in _POOL}
    names = {name: tuple(pool[name].tolist()) for name in ("ids", "bands")}
    return state, CandidatePool(**{**pool, **names})
