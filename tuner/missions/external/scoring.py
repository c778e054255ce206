"""A cloud of a mission that is not ours, measured as ours are."""

from __future__ import annotations

import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from nbv.cache import Store
from nbv.config import MissionConfig, preset
from nbv.errors import MissionFailure
from nbv.evaluation import evaluate_cloud
from nbv.foreign import read_bytes
from nbv.geometry.frames import Similarity, align_umeyama
from nbv.rocks import load_rock
from nbv.types import Floats, PointCloud
from tuner.missions.external.mission_file import MissionFile

MAX_CLOUD_BYTES = 2 * 1024**3
_FEWEST_CAMERAS = 3


def scoring_config(mission: MissionFile) -> MissionConfig:
    """What ``score`` of the mission file means; ``UserError`` for a preset or a parameter that there is not."""
    score = mission.score or {}
    return preset(score.get("preset", "campaign")).with_values(dict(score.get("set", {})))


def score_cloud(
    mission: MissionFile, instance: str, output: Path, cloud: Mapping[str, Any], store: Store | None
) -> dict[str, Any]:
    """The metrics of the PLY that a result names, against its instance's mesh.

    The mesh is a file beside the mission file, as `nbv.rocks.import_mesh` places it, or a rock's name. With ``cameras`` the
    cloud is first aligned by the least-squares similarity from estimated to reported centres (Umeyama, PAMI 1991).

    Raises
    ------
    MissionFailure
        The cloud cannot be read, aligned or measured.
    UserError
        There is no such mesh.
    """
    file = mission.folder / (mesh := str(mission.instance(instance).facts["mesh"]))
    rock = load_rock(str(file) if file.is_file() else mesh, store)
    points_m = _read_points(output / cloud["path"])
    if cameras := cloud.get("cameras"):
        points_m = _world_from_cloud(cameras).apply(points_m)
    return evaluate_cloud(PointCloud(points_m), rock, scoring_config(mission), store).metrics


def _read_points(path: Path) -> Floats:
    """(N, 3) vertices of a PLY."""
    try:
        if path.stat().st_size > MAX_CLOUD_BYTES:
            raise MissionFailure("cloud_too_large", f"{path} has more than {MAX_CLOUD_BYTES} bytes")
        loaded = trimesh.load(io.BytesIO(read_bytes(path, MAX_CLOUD_BYTES)), file_type="ply", process=False)
        points = np.asarray(loaded.vertices, dtype=float)
    except MissionFailure:
        raise
    except Exception as error:  # a parser's own families of errors
        raise MissionFailure(
            "cloud_unreadable", f"{path} cannot be read as a PLY ({type(error).__name__})"
        ) from error
    points = points[np.isfinite(points).all(axis=1)] if points.ndim == 2 else points
    if points.ndim != 2 or len(points) == 0:
        raise MissionFailure("cloud_empty", f"{path} has no points")
    return points


def _world_from_cloud(cameras: Mapping[str, Mapping[str, Any]]) -> Similarity:
    reported = np.array([camera["reported"] for camera in cameras.values()], dtype=float)
    estimated = np.array([camera["estimated"] for camera in cameras.values()], dtype=float)
    if len(cameras) < _FEWEST_CAMERAS:
        raise MissionFailure("too_few_cameras", f"{len(cameras)} cameras align no cloud; it takes 3")
    try:
        return align_umeyama(reported, estimated)
    except ValueError as error:
        raise MissionFailure("not_aligned", str(error)) from error
