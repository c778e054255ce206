"""COLMAP's dense workspace on disk: for PatchMatch, and to export our depth maps to COLMAP's fusion.

Layout: ``images/``, ``sparse/`` (binary model), ``stereo/{depth_maps,normal_maps,consistency_graphs}/``,
``stereo/patch-match.cfg``, ``stereo/fusion.cfg``. COLMAP's stereo reads pixel centres at integers, so the
principal point is written half a pixel off the sparse convention.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

# cv2 (through stereo) before pycolmap: the other order makes libpng crash the process.
from nbv.dense.stereo import backproject, depth_normals, pixel_matrix

# isort: split
import numpy as np
import pycolmap
from PIL import Image as PillowImage

from nbv.config import CameraConfig, DenseConfig
from nbv.dense.interface import DepthMap, Floats32, Image
from nbv.errors import MissionFailure
from nbv.types import Floats, PointCloud

_LINK_POINTS_PER_VIEW = 200  # sparse points per view, which tell COLMAP which views overlap
_LINK_RELATIVE_DEPTH = 0.01


def write_images(
    workspace: Path,
    images: Mapping[str, Image],
    camera_from_world: Mapping[str, Floats],
    camera: CameraConfig,
    links: Sequence[tuple[Floats, dict[str, Floats]]] = (),
) -> None:
    """Write photographs and the sparse model.

    Parameters
    ----------
    links
        Sparse points: world position (3,) and, by view name, the pixel (2,) where it is seen.
    """
    for folder in (
        "images",
        "sparse",
        "stereo/depth_maps",
        "stereo/normal_maps",
        "stereo/consistency_graphs",
    ):
        (workspace / folder).mkdir(parents=True, exist_ok=True)
    names = sorted(images)
    observed: dict[str, list[Floats]] = {name: [] for name in names}
    tracks = []
    for _, pixels in links:
        track = []
        for name, pixel in pixels.items():
            track.append((name, len(observed[name])))
            observed[name].append(pixel)
        tracks.append(track)

    matrix = pixel_matrix(camera)
    model = pycolmap.Reconstruction()
    model.add_camera_with_trivial_rig(
        pycolmap.Camera(
            camera_id=1,
            model="PINHOLE",
            width=camera.width_px,
            height=camera.height_px,
            params=[matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]],
        )
    )
    ids = {name: index for index, name in enumerate(names, start=1)}
    for name in names:
        PillowImage.fromarray(images[name]).save(workspace / "images" / file_name(name))
        keypoints = np.array(observed[name], dtype=float).reshape(-1, 2)
        model.add_image_with_trivial_frame(
            pycolmap.Image(name=file_name(name), keypoints=keypoints, camera_id=1, image_id=ids[name]),
            pycolmap.Rigid3d(np.asarray(camera_from_world[name], dtype=float)[:3]),
        )
    for (position, _), track in zip(links, tracks):
        elements = [pycolmap.TrackElement(ids[name], index) for name, index in track]
        model.add_point3D(np.asarray(position, dtype=float), pycolmap.Track(elements))
    model.write(workspace / "sparse")
    (workspace / "stereo" / "fusion.cfg").write_text("".join(f"{file_name(n)}\n" for n in names))


def write_stereo_sources(workspace: Path, sources: Mapping[str, Sequence[str]]) -> None:
    """Write ``patch-match.cfg``: the views that each reference view is matched with."""
    lines = []
    for name in sorted(sources):
        lines += [file_name(name), ", ".join(file_name(other) for other in sources[name])]
    (workspace / "stereo" / "patch-match.cfg").write_text("\n".join(lines) + "\n")


def write_depth_maps(workspace: Path, depth_maps: Mapping[str, DepthMap], camera: CameraConfig) -> None:
    """Write depth and normal maps as COLMAP's ``geometric`` maps; 0 where unknown.

    Normals are made from the depth where a map has none; a pixel needs both.
    """
    for name in sorted(depth_maps):
        item = depth_maps[name]
        normals = item.normals
        if normals is None:
            normals = depth_normals(backproject(item.depth_m, camera))
        known = np.isfinite(item.depth_m) & np.isfinite(normals).all(-1)
        depth = np.where(known, item.depth_m, 0.0).astype(np.float32)
        normals = np.where(known[..., None], normals, 0.0).astype(np.float32)
        file = f"{file_name(name)}.geometric.bin"
        near, far = (float(depth[known].min()), float(depth[known].max())) if known.any() else (0.0, 0.0)
        stereo = workspace / "stereo"
        pycolmap.DepthMap.from_array(depth, near, far).write(stereo / "depth_maps" / file)
        pycolmap.NormalMap.from_array(normals).write(stereo / "normal_maps" / file)


def read_depth_maps(workspace: Path, names: Sequence[str], kind: str = "geometric") -> dict[str, DepthMap]:
    """Read COLMAP's maps back; NaN where COLMAP has no depth. Views without a file are left out."""
    maps = {}
    for name in sorted(names):
        files = [
            workspace / "stereo" / folder / f"{file_name(name)}.{kind}.bin"
            for folder in ("depth_maps", "normal_maps")
        ]
        if not all(file.is_file() for file in files):
            continue
        depth_map, normal_map = pycolmap.DepthMap(), pycolmap.NormalMap()
        depth_map.read(files[0])
        normal_map.read(files[1])
        depth = np.array(depth_map.to_array(), dtype=np.float32)
        normals = np.array(normal_map.to_array(), dtype=np.float32)
        unknown = ~(depth > 0)
        depth[unknown], normals[unknown] = np.nan, np.nan
        maps[name] = DepthMap(depth, normals)
    return maps


def overlap_links(
    depth_maps: Mapping[str, DepthMap], camera_from_world: Mapping[str, Floats], camera: CameraConfig
) -> list[tuple[Floats, dict[str, Floats]]]:
    """Sparse points with tracks, taken from the depth maps on a regular grid.

    COLMAP decides from shared sparse points which views overlap; without any it fuses nothing. A track
    holds the views whose depth at the point's pixel agrees within 1 %.
    """
    matrix = pixel_matrix(camera)
    links = []
    for name in sorted(depth_maps):
        depth = depth_maps[name].depth_m
        rows, columns = np.nonzero(np.isfinite(depth))
        if rows.size == 0:
            continue
        pick = np.unique(np.linspace(0, rows.size - 1, _LINK_POINTS_PER_VIEW).astype(int))
        pose = camera_from_world[name]
        local = backproject(depth, camera)[rows[pick], columns[pick]].astype(float)
        world = (local - pose[:3, 3]) @ pose[:3, :3]
        seen = {
            other: _observe(world, depth_maps[other].depth_m, camera_from_world[other], matrix)
            for other in sorted(depth_maps)
        }
        for index, position in enumerate(world):
            pixels = {other: pixel[index] for other, (ok, pixel) in seen.items() if ok[index]}
            if len(pixels) >= 2:
                links.append((position, pixels))
    return links


def _observe(world: Floats, depth_m: Floats32, pose: Floats, matrix: Floats) -> tuple[np.ndarray, Floats]:
    local = world @ pose[:3, :3].T + pose[:3, 3]
    z = np.maximum(local[:, 2], 1e-6)
    pixel = (local[:, :2] * matrix[0, 0]) / z[:, None] + matrix[:2, 2]
    column, row = np.rint(pixel).astype(int).T
    inside = (column >= 0) & (column < depth_m.shape[1]) & (row >= 0) & (row < depth_m.shape[0])
    inside &= local[:, 2] > 0
    measured = np.full(len(world), np.nan)
    measured[inside] = depth_m[row[inside], column[inside]]
    return np.abs(measured - z) < _LINK_RELATIVE_DEPTH * z, pixel


def fuse_with_colmap(
    workspace: Path,
    depth_maps: Mapping[str, DepthMap],
    images: Mapping[str, Image],
    camera_from_world: Mapping[str, Floats],
    camera: CameraConfig,
    config: DenseConfig,
    *,
    max_normal_error_deg: float = 90.0,
) -> PointCloud:
    """Fuse depth maps with COLMAP's own stereo fusion (CPU): an export, and a check of `nbv.dense.fusion`.

    The workspace is left on disk and can be opened with COLMAP. ``config.agreeing_views`` becomes
    ``min_num_pixels``. COLMAP's default normal test (10 degrees) suits PatchMatch, whose normals are
    optimised; normals differentiated from matched depths need a wide one.

    Parameters
    ----------
    workspace
        Directory for the workspace; made if absent.

    Raises
    ------
    MissionFailure
        ``empty_dense_cloud``: COLMAP fused nothing.
    """
    links = overlap_links(depth_maps, camera_from_world, camera)
    used = {name: images[name] for name in sorted(depth_maps)}
    write_images(workspace, used, camera_from_world, camera, links)
    write_depth_maps(workspace, depth_maps, camera)
    options = pycolmap.StereoFusionOptions(
        num_threads=1,
        min_num_pixels=config.agreeing_views,
        max_normal_error=max_normal_error_deg,
        max_depth_error=config.consistency_relative_depth,
        max_reproj_error=config.consistency_px,
    )
    fused = pycolmap.stereo_fusion(
        workspace / "fused.ply", workspace, input_type="geometric", options=options, output_type="ply"
    )
    points = list(fused.points3D.values())
    if not points:
        raise MissionFailure("empty_dense_cloud", "COLMAP's stereo fusion returned no point")
    return PointCloud(np.array([p.xyz for p in points]), np.array([p.color for p in points], dtype=np.uint8))


def file_name(view: str) -> str:
    """Image file name of a view; COLMAP wants a suffix."""
    return view if view.lower().endswith((".png", ".jpg", ".jpeg")) else f"{view}.png"
