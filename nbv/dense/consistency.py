"""Geometric consistency: a depth is kept when enough other views' depth maps confirm it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from nbv.dense.views import DepthMaps, PosedViews, pixel_matrix
from nbv.types import Floats32


def check_consistency(depth_maps: DepthMaps, views: PosedViews) -> DepthMaps:
    """Check every depth map (H, W) against up to ``consistency_views`` others; NaN where too few agree.

    A view agrees where its depth differs from the point's by less than ``consistency_relative_depth``, and its own
    surface point on that ray projects back within ``consistency_px``. The reference itself counts among the
    ``agreeing_views``; depths become the mean of those that agree.
    """
    views = replace(views, camera_from_world={name: views.camera_from_world[name] for name in depth_maps})
    return {name: _check(name, depth_maps, views) for name in sorted(depth_maps)}


def _check(name: str, depth_maps: DepthMaps, views: PosedViews) -> Floats32:
    depth_m, pose, config = depth_maps[name], views.camera_from_world[name], views.config
    matrix = pixel_matrix(views.camera)
    focal, cx, cy = (np.float32(value) for value in (matrix[0, 0], matrix[0, 2], matrix[1, 2]))
    rows, columns = np.nonzero(np.isfinite(depth_m))
    depth = depth_m[rows, columns]
    u, v = columns.astype(np.float32), rows.astype(np.float32)
    # (3, n) points in the reference's camera frame; single precision is exact to well below 1 mm here.
    points = np.stack([(u - cx) / focal * depth, (v - cy) / focal * depth, depth])
    agreeing = np.ones(len(depth), dtype=np.uint8)
    total = depth.copy()
    height, width = depth_m.shape
    inverse_rotation = pose[:3, :3].T
    for source in views.source_views[name]:
        other_depth, other_pose = depth_maps[source], views.camera_from_world[source]
        rotation64 = other_pose[:3, :3] @ inverse_rotation
        translation64 = other_pose[:3, 3] - rotation64 @ pose[:3, 3]
        rotation, translation = rotation64.astype(np.float32), translation64.astype(np.float32)[:, None]
        seen = rotation @ points
        seen += translation
        z = np.maximum(seen[2], np.float32(1e-6))
        column = np.rint(seen[0] / z * focal + cx)
        row = np.rint(seen[1] / z * focal + cy)
        inside = (column >= 0) & (column < width) & (row >= 0) & (row < height) & (seen[2] > 0)
        index = np.flatnonzero(inside)
        z = z.take(index)
        pixel = row.take(index).astype(np.intp) * width + column.take(index).astype(np.intp)
        measured = other_depth.reshape(-1).take(pixel)
        # NaN compares false, so unknown depths drop out here.
        close = np.flatnonzero(np.abs(measured - z) < config.consistency_relative_depth * z)
        measured, z = measured.take(close), z.take(close)
        index = index.take(close)
        # The source view's point on the same ray, back in the reference.
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
