"""The same mission as a recording for Rerun's viewer (extra ``viewer``)."""

from __future__ import annotations

import base64
from pathlib import Path
from types import ModuleType
from typing import Any

import matplotlib
import numpy as np

from nbv.errors import UserError
from nbv.geometry.frames import invert_rigid, look_at
from tuner.report.mission.walk_data import walk_of
from tuner.report.mission.walk_world import ERROR_STEP_MM, MISSING_STEP_MM, STEP_M
from tuner.report.style import SEQUENTIAL

_ERROR_RANGE_MM, _MISSING_RANGE_MM = 16.0, 80.0


def write_mission_recording(run: Path, out: Path, rock: str | None = None) -> Path:
    """Write ``out`` (``.rrd``): what `write_mission_view` shows, on a timeline of captures.

    Raises
    ------
    UserError
        The package ``rerun-sdk`` is missing, or as `walk_of`.
    """
    try:
        import rerun as rr  # noqa: PLC0415  an extra
    except ImportError as error:
        raise UserError("--rrd needs rerun-sdk; run: pip install 'gatetune[viewer]'") from error
    facts = walk_of(run, rock).facts
    recording = rr.RecordingStream("gatetune", recording_id=str(facts["name"]))
    try:
        recording.save(out)
    except OSError as error:
        raise UserError(f"cannot write {out}; choose another --rrd") from error
    _lasting(rr, recording, facts)
    for number, step in enumerate(facts["steps"]):
        recording.set_time("capture", sequence=number)
        _step(rr, recording, facts, step)
    recording.flush()
    return out


def _lasting(rr: ModuleType, recording: Any, facts: dict[str, Any]) -> None:
    recording.log("/", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    mesh, truth, dense = facts["mesh"], facts["truth"], facts["dense"]
    faces = _read(mesh["f"], "<u4").reshape(-1, 3)
    recording.log(
        "rock", rr.Mesh3D(vertex_positions=_points(facts, mesh["p"]), triangle_indices=faces), static=True
    )
    missing_mm = _read(truth["m"], "u1") * MISSING_STEP_MM
    seen = _read(truth["o"], "u1") > 0
    for name, chosen in (("observable", seen), ("hidden", ~seen)):
        cloud = _points(facts, truth["p"])[chosen]
        colours = _coloured(missing_mm[chosen], _MISSING_RANGE_MM)
        recording.log(f"truth/{name}", rr.Points3D(cloud, colors=colours, radii=0.004), static=True)
    if dense is not None:
        colours = _coloured(_read(dense["e"], "u1") * ERROR_STEP_MM, _ERROR_RANGE_MM)
        recording.log(
            "dense", rr.Points3D(_points(facts, dense["p"]), colors=colours, radii=0.003), static=True
        )


def _step(rr: ModuleType, recording: Any, facts: dict[str, Any], step: dict[str, Any]) -> None:
    samples = _read(facts["path"], "<f4").reshape(-1, 4)
    recording.log("path", rr.LineStrips3D([samples[samples[:, 0] <= step["t"] + 1e-6, 1:]]))
    view = facts["views"][step["views"] - 1]
    world_from_camera = invert_rigid(look_at(np.array(view["at"]), np.array(facts["target"])))
    where = f"cameras/{view['name']}"
    recording.log(
        where, rr.Transform3D(translation=world_from_camera[:3, 3], mat3x3=world_from_camera[:3, :3])
    )
    width, height, focal = facts["camera"]
    recording.log(
        where,
        rr.Pinhole(focal_length=focal, width=width, height=height, image_plane_distance=0.24),
    )
    if "image" in view:
        recording.log(
            f"{where}/photograph",
            rr.EncodedImage(contents=base64.b64decode(view["image"]), media_type="image/jpeg"),
        )
    if step["model"] >= 0:
        model = facts["models"][step["model"]]
        colours = _coloured(_read(model["e"], "u1") * ERROR_STEP_MM, _ERROR_RANGE_MM)
        recording.log("sparse", rr.Points3D(_points(facts, model["p"]), colors=colours, radii=0.006))
    if step.get("d95_mm") is not None:
        recording.log("d95_mm", rr.Scalars(step["d95_mm"]))
    if step.get("sparse_completeness") is not None:
        recording.log("sparse_completeness_percent", rr.Scalars(step["sparse_completeness"]))
    if "pool" in step:
        scores = step["pool"]["scores"].get(step["scorer"])
        values = np.array(scores) if scores else np.zeros(len(step["pool"]["ids"]))
        colours = _coloured(values - values.min(), max(float(np.ptp(values)), 1e-9))
        recording.log("pool", rr.Points3D(step["pool"]["at"], colors=colours, radii=0.04))
        recording.log("decision", rr.TextLog(f"{step['label']} ({step['scorer']}): {step['reason']}"))


def _read(packed: str, dtype: str) -> np.ndarray:
    return np.frombuffer(base64.b64decode(packed), dtype=dtype)


def _points(facts: dict[str, Any], packed: str) -> np.ndarray:
    """(N, 3) metres."""
    points: np.ndarray = np.array(facts["origin"]) + STEP_M * _read(packed, "<i2").reshape(-1, 3)
    return points


def _coloured(values: np.ndarray, span: float) -> np.ndarray:
    """(N, 3) uint8."""
    colours = matplotlib.colormaps[SEQUENTIAL](np.clip(values / span, 0, 1))
    return (255 * colours[:, :3]).astype(np.uint8)
