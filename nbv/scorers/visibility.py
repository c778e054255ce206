"""Which sparse points a candidate would see.

``frustum`` is the paper's: inside the image of an exact zero-roll camera aimed at the target, and
nothing else, so points behind the rock count. ``occlusion`` is added in `nbv.scorers.occlusion`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nbv.config import CameraConfig
from nbv.frames import look_at
from nbv.types import Floats

BLOCK = 256  # points at a time: a block's (BLOCK, C) arrays stay in the processor's cache


def frustum_planes(positions_m: Floats, target_m: Floats, camera: CameraConfig) -> tuple[Floats, ...]:
    """Rows that turn points into scaled camera coordinates, for every candidate at once.

    Returns three (4, C) arrays ``x, y, z``: for homogeneous points ``q`` (P, 4), ``q @ z`` is the depth,
    and a point is in the image if and only if ``abs(q @ x) <= q @ z`` and ``abs(q @ y) <= q @ z``.
    (The principal point is the image's centre, so both tests are symmetric and imply a positive depth.)
    """
    poses = np.stack([look_at(p, target_m) for p in positions_m])[:, :3]  # (C, 3, 4)
    x = poses[:, 0] * (camera.focal_px / (camera.width_px / 2.0))
    y = poses[:, 1] * (camera.focal_px / (camera.height_px / 2.0))
    return np.ascontiguousarray(x.T), np.ascontiguousarray(y.T), np.ascontiguousarray(poses[:, 2].T)


def in_frustum(
    points_m: Floats, positions_m: Floats, target_m: Floats, camera: CameraConfig
) -> NDArray[np.bool_]:
    """(P, C): is each point in the image of the camera at each position, aimed at the target?"""
    x, y, z = frustum_planes(positions_m, target_m, camera)
    visible = np.empty((len(points_m), len(positions_m)), dtype=bool)
    for start in range(0, len(points_m), BLOCK):
        block = points_m[start : start + BLOCK]
        q = np.concatenate([block, np.ones((len(block), 1))], axis=1)
        depth = q @ z
        inside = np.abs(q @ x) <= depth
        inside &= np.abs(q @ y) <= depth
        visible[start : start + BLOCK] = inside
    return visible
