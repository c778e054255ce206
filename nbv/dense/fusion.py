"""From consistent depth maps to one coloured point cloud with normals."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from nbv.config import CameraConfig, DenseConfig
from nbv.dense.interface import Floats32, Image
from nbv.dense.stereo import backproject, depth_normals
from nbv.errors import MissionFailure
from nbv.types import Floats, PointCloud


def fuse(
    depth_maps: Mapping[str, Floats32],
    images: Mapping[str, Image],
    camera_from_world: Mapping[str, Floats],
    camera: CameraConfig,
    target_m: tuple[float, float, float] | Floats,
    config: DenseConfig,
) -> PointCloud:
    """Back-project all depths near the target and average what falls into one voxel.

    The average removes duplicates of the same surface seen by several views and some of their noise; it
    does not depend on the order of the views up to rounding. Points farther than ``crop_half_width_m``
    from the target along any axis are left out. A normal is the mean over the voxel of the depth maps'
    normals, or the mean direction to the cameras where no depth map has one.

    Parameters
    ----------
    depth_maps
        (H, W) consistent depths in metres, NaN where unknown, by view name.

    Raises
    ------
    MissionFailure
        ``empty_dense_cloud``: no depth at all.
    """
    target = np.asarray(target_m, dtype=float)
    points, normals, colors = [], [], []
    for name in sorted(depth_maps):
        depth = depth_maps[name]
        rotation, translation = camera_from_world[name][:3, :3], camera_from_world[name][:3, 3]
        rows, columns = np.nonzero(np.isfinite(depth))
        if rows.size == 0:
            continue
        y0, y1, x0, x1 = rows.min(), rows.max() + 1, columns.min(), columns.max() + 1
        local = backproject(depth, camera, (y0, y1, x0, x1))
        normal = depth_normals(local)[rows - y0, columns - x0]
        camera_points = local[rows - y0, columns - x0]
        world = (camera_points - translation.astype(np.float32)) @ rotation.astype(np.float32)
        inside = np.abs(world - target.astype(np.float32)).max(axis=1) <= config.crop_half_width_m
        missing = ~np.isfinite(normal[:, 0])
        # A small weight: only decides where no real normal falls into the voxel.
        fallback = camera_points[missing]
        normal[missing] = -1e-3 * fallback / np.linalg.norm(fallback, axis=1, keepdims=True)
        points.append(world[inside])
        normals.append((normal @ rotation.astype(np.float32))[inside])
        colors.append(images[name][rows, columns][inside])
    if sum(map(len, points)) == 0:
        raise MissionFailure(
            "empty_dense_cloud", f"no depth is confirmed by {config.agreeing_views} views near the target"
        )
    return _voxel_average(
        np.concatenate(points), np.concatenate(normals), np.concatenate(colors), target, config.fusion_voxel_m
    )


def _voxel_average(
    points: Floats32, normals: Floats32, colors: np.ndarray, origin: Floats, voxel_m: float
) -> PointCloud:
    cell = np.floor((points - origin.astype(np.float32)) / np.float32(voxel_m)).astype(np.int64)
    cell -= cell.min(axis=0)
    extent = cell.max(axis=0) + 1
    key = (cell[:, 0] * extent[1] + cell[:, 1]) * extent[2] + cell[:, 2]
    order = np.argsort(key, kind="stable")
    starts = np.flatnonzero(np.concatenate([[True], np.diff(key[order]) > 0]))
    counts = np.diff(np.append(starts, len(order)))[:, None]

    def total(values: np.ndarray) -> Floats:
        return np.add.reduceat(values[order].astype(np.float64), starts, axis=0)

    normal = total(normals)
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    return PointCloud(
        points_m=total(points) / counts,
        colors=np.rint(total(colors) / counts).astype(np.uint8),
        normals=normal / np.maximum(length, 1e-12),
    )
