"""A cloud of a mission that is not ours, measured as ours are."""

from __future__ import annotations

import hashlib
import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from scipy.spatial import KDTree

from nbv.cache import Store
from nbv.config import MissionConfig, preset
from nbv.errors import MissionFailure
from nbv.evaluation import evaluate_cloud
from nbv.geometry.frames import Similarity, align_umeyama
from nbv.rocks import Rock, frame_of_file, load_rock
from nbv.safe_files import read_bytes
from nbv.types import Floats, PointCloud
from tuner.missions.external.mission_file import MissionFile

MAX_CLOUD_BYTES = 2 * 1024**3
_FEWEST_CAMERAS = 3
_OVERLAP_SAMPLES = 20_000
_NEAR = 0.1  # of the mesh's height
_LEAST_OVERLAP = 0.1  # share of points


def scoring_config(mission: MissionFile) -> MissionConfig:
    """What ``score`` of the mission file means; ``UserError`` for a preset or a parameter that there is not."""
    score = mission.score or {}
    return preset(score.get("preset", "campaign")).with_values(dict(score.get("set", {})))


def score_cloud(
    mission: MissionFile, instance: str, output: Path, cloud: Mapping[str, Any], store: Store | None
) -> tuple[dict[str, Any], str]:
    """The metrics of the PLY that a result names against its instance's mesh, and a warning where they hardly overlap.

    The mesh is a file beside the mission file, or a rock's name. With ``cameras`` the cloud is first aligned by the
    least-squares similarity from estimated to reported centres (Umeyama, PAMI 1991). It is then in the mesh's own frame
    (``frame: mesh``) and moved with the mesh to where `nbv.rocks.import_mesh` puts that, or there already (``frame: rock``).

    Raises
    ------
    MissionFailure
        The cloud cannot be read (the machine's failure), aligned or measured.
    UserError
        There is no such mesh.
    """
    mesh, file = _mesh(mission, instance)
    rock = load_rock(mesh if file is None else str(file), store)
    points_m = _read_points(output / cloud["path"])
    if cameras := cloud.get("cameras"):
        points_m = _world_from_cloud(cameras).apply(points_m)
    if file is not None and (mission.score or {}).get("frame", "mesh") == "mesh":
        points_m = frame_of_file(file).apply(points_m)
    warning = _hardly_overlap(points_m, rock, mesh)
    try:
        return evaluate_cloud(PointCloud(points_m), rock, scoring_config(mission), store).metrics, warning
    except MissionFailure as error:
        if not warning:
            raise
        raise MissionFailure(error.reason, f"{error.message}; {warning}") from error


def mesh_sha256(mission: MissionFile, instance: str) -> str:
    """Of the mesh that clouds are measured against; empty where none is, `UserError` where it cannot be read."""
    if mission.score is None:
        return ""
    mesh, file = _mesh(mission, instance)
    return (
        load_rock(mesh).sha256
        if file is None
        else hashlib.sha256(read_bytes(file, MAX_CLOUD_BYTES)).hexdigest()
    )


def _mesh(mission: MissionFile, instance: str) -> tuple[str, Path | None]:
    """What the mission file says, and the file that this is: None for a rock's name."""
    mesh = str(mission.instance(instance).facts["mesh"])
    return mesh, file if (file := mission.folder / mesh).is_file() else None


def _hardly_overlap(points_m: Floats, rock: Rock, mesh: str) -> str:
    """A sentence where hardly any of the cloud (N, 3) is near the mesh, or hardly any of the mesh near the cloud."""
    cloud, surface = (some[:: max(1, len(some) // _OVERLAP_SAMPLES)] for some in (points_m, rock.vertices_m))
    reach_m = _NEAR * float(np.ptp(rock.vertices_m[:, 2]))
    near = [
        float(np.isfinite(KDTree(there).query(here, distance_upper_bound=reach_m)[0]).mean())
        for here, there in ((cloud, surface), (surface, cloud))
    ]
    if min(near) >= _LEAST_OVERLAP:
        return ""
    return (
        f"cloud and mesh hardly overlap: {100 * near[0]:.0f} % of the cloud is near {mesh}, {100 * near[1]:.0f} % of that near "
        "the cloud; put both into one frame (docs/how-to/your-mission.md)"
    )


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
            "machine_error: cloud_unreadable", f"{path} cannot be read as a PLY ({type(error).__name__})"
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
