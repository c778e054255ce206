"""Geometric consistency: a depth is kept when enough other views' depth maps confirm it."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from nbv.config import CameraConfig, DenseConfig
from nbv.dense.interface import Floats32
from nbv.dense.stereo import camera_center_m, pixel_matrix, viewing_angle_deg
from nbv.types import Floats


def choose_witnesses(
    reference: str,
    camera_from_world: Mapping[str, Floats],
    target_m: tuple[float, float, float] | Floats,
    count: int,
) -> list[str]:
    """The other views nearest in viewing direction as seen from the target; ties by name.

    Parameters
    ----------
    reference
        Name of the view.
    camera_from_world
        (4, 4) of all views by name, metres.
    target_m
        (3,) the point that the cameras aim at.
    count
        How many.
    """
    target = np.asarray(target_m, dtype=float)
    center = camera_center_m(camera_from_world[reference])
    angles = [
        (viewing_angle_deg(center, camera_center_m(pose), target), name)
        for name, pose in camera_from_world.items()
        if name != reference
    ]
    return [name for _, name in sorted(angles)[:count]]


def check_consistency(
    depth_maps: Mapping[str, Floats32],
    camera_from_world: Mapping[str, Floats],
    camera: CameraConfig,
    target_m: tuple[float, float, float] | Floats,
    config: DenseConfig,
) -> dict[str, Floats32]:
    """Check every depth map against up to ``consistency_views`` others.

    A view agrees with a pixel when, at the point's projection into it, its depth differs from the
    point's by less than ``consistency_relative_depth``, and its own surface point on that ray projects
    back within ``consistency_px`` of the pixel. Pixels with at least ``agreeing_views`` agreeing views
    *including the reference itself* are kept (so 2 means one confirmation), and their depth becomes the
    mean of the agreeing depths along the reference's ray.

    Parameters
    ----------
    depth_maps
        (H, W) metres along the optical axis by view; NaN where unknown.
    camera_from_world
        (4, 4) by view, metres.
    camera
        Known intrinsics.
    target_m
        (3,) the point that the cameras aim at.
    config
        Its ``consistency_*`` and ``agreeing_views``.

    Returns
    -------
    (H, W) depth by view; NaN where too few agree.
    """
    poses = {name: camera_from_world[name] for name in depth_maps}
    return {
        name: _check(
            depth_maps[name],
            poses[name],
            [
                (depth_maps[other], poses[other])
                for other in choose_witnesses(name, poses, target_m, config.consistency_views)
            ],
            camera,
            config,
        )
        for name in sorted(depth_maps)
    }


def _check(
    depth_m: Floats32,
    pose: Floats,
    witnesses: list[tuple[Floats32, Floats]],
    camera: CameraConfig,
    config: DenseConfig,
) -> Floats32:
    matrix = pixel_matrix(camera)
    focal, cx, cy = (np.float32(value) for value in (matrix[0, 0], matrix[0, 2], matrix[1, 2]))
    rows, columns = np.nonzero(np.isfinite(depth_m))
    depth = depth_m[rows, columns]
    u, v = columns.astype(np.float32), rows.astype(np.float32)
    # (3, n) points in the reference's camera frame; single precision is exact to well below 1 mm here.
    points = np.stack([(u - cx) / focal * depth, (v - cy) / focal * depth, depth])
    agreeing = np.ones(len(depth), dtype=np.uint8)
    total = depth.copy()
    height, width = depth_m.shape
    whole = np.float32 if height * width < 2**24 else np.float64  # exact for all indices of pixels
    inverse_rotation = pose[:3, :3].T
    for other_depth, other_pose in witnesses:
        rotation64 = other_pose[:3, :3] @ inverse_rotation
        translation64 = other_pose[:3, 3] - rotation64 @ pose[:3, 3]
        rotation, translation = rotation64.astype(np.float32), translation64.astype(np.float32)[:, None]
        seen = rotation @ points
        seen += translation
        z = np.maximum(seen[2], np.float32(1e-6))
        column = np.rint(seen[0] / z * focal + cx)
        row = np.rint(seen[1] / z * focal + cy)
        inside = (column >= 0) & (column < width) & (row >= 0) & (row < height) & (seen[2] > 0)
        # Where all pixels project into the witness, as is usual, nothing needs to be picked out.
        index = None if inside.all() else np.flatnonzero(inside)
        pixel = row.astype(whole) * width + column
        z, pixel = _picked(z, index), _picked(pixel, index)
        measured = other_depth.reshape(-1).take(pixel.astype(np.intp))
        # NaN compares false, so unknown depths drop out here.
        close = np.flatnonzero(np.abs(measured - z) < config.consistency_relative_depth * z)
        measured, z = measured.take(close), z.take(close)
        index = close if index is None else index.take(close)
        # The witness's point on the same ray, back in the reference.
        back = rotation.T @ (seen.take(index, axis=1) * (measured / z) - translation)
        du = back[0] / back[2] * focal + cx - u.take(index)
        dv = back[1] / back[2] * focal + cy - v.take(index)
        near = np.flatnonzero(du * du + dv * dv < np.float32(config.consistency_px**2))
        index = index.take(near)
        agreeing[index] += 1
        total[index] += back[2].take(near)
    keep = agreeing >= config.agreeing_views
    out = np.full_like(depth_m, np.nan)
    out[rows[keep], columns[keep]] = total[keep] / agreeing[keep]
    return out


def _picked(values: Floats32, index: NDArray[np.intp] | None) -> Floats32:
    return values if index is None else values.take(index)
