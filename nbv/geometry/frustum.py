"""Which sparse points a candidate would see.

As in the paper: those inside the image of an exact zero-roll camera aimed at the target, and nothing else, so points
behind the rock count.
"""

from __future__ import annotations

import numpy as np

from nbv.config import CameraConfig
from nbv.types import Bools, Floats

BLOCK = 256  # points at a time: a block's (BLOCK, C) arrays stay in the processor's cache


def in_frustum(points_m: Floats, positions_m: Floats, target_m: Floats, camera: CameraConfig) -> Bools:
    """(P, C): is each point (P, 3) in the image of the camera at each position (C, 3), aimed at the target (3,)?

    The principal point is the image's centre: a point is inside where neither of its scaled coordinates across the line of
    sight exceeds its depth.
    """
    right, down, forward = camera_axes(positions_m, target_m)
    x, y, z = (
        scale * np.concatenate([axis.T, -np.einsum("ij,ij->i", axis, positions_m)[None]])
        for axis, scale in (
            (right, camera.focal_px / (camera.width_px / 2.0)),
            (down, camera.focal_px / (camera.height_px / 2.0)),
            (forward, 1.0),
        )
    )
    homogeneous = np.column_stack([points_m, np.ones(len(points_m))])
    visible = np.empty((len(points_m), len(positions_m)), dtype=bool)
    for start in range(0, len(points_m), BLOCK):
        block = homogeneous[start : start + BLOCK]
        off_axis = np.maximum(np.abs(block @ x), np.abs(block @ y))
        visible[start : start + BLOCK] = off_axis <= block @ z
    return visible


def camera_axes(positions_m: Floats, target_m: Floats) -> tuple[Floats, Floats, Floats]:
    """(C, 3) each: right, down and forward of `nbv.geometry.frames.look_at` for every position at once."""
    forward = target_m - positions_m
    forward = forward / np.linalg.norm(forward, axis=1, keepdims=True)
    right = np.cross(forward, (0.0, 0.0, 1.0))
    straight = np.linalg.norm(right, axis=1) < 1e-9  # up or down: the image's up is north
    right[straight] = np.cross(forward[straight], (0.0, 1.0, 0.0))
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    return right, np.cross(forward, right), forward
