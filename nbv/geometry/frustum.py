"""Which sparse points a candidate would see.

As in the paper: those inside the image of an exact zero-roll camera aimed at the target, and nothing else, so points
behind the rock count.
"""

from __future__ import annotations

import numpy as np

from nbv.config import CameraConfig
from nbv.geometry.frames import look_at
from nbv.geometry.scratch import scratch
from nbv.types import Bools, Floats

BLOCK = 256  # points at a time: a block's (BLOCK, C) arrays stay in the processor's cache
BORDER_M = 1e-5  # single precision errs by some 1e-6 m at 5 m


def look_at_many(positions_m: Floats, target_m: Floats) -> Floats:
    """(C, 4, 4) `nbv.geometry.frames.look_at` for every position at once."""
    forward = (target_m - positions_m).T.copy()
    fx, fy, fz = forward
    forward /= np.sqrt(fx * fx + fy * fy + fz * fz)
    length = np.sqrt(fy * fy + fx * fx)
    if (length < 1e-9).any():  # straight above or below: look_at's convention
        return np.stack([look_at(p, target_m) for p in positions_m])
    rx, ry = fy / length, -fx / length  # forward x up; level
    rotation = np.zeros((len(positions_m), 3, 3))  # rows: right, forward x right, forward
    for (row, column), value in {
        (0, 0): rx,
        (0, 1): ry,
        (1, 0): -(fz * ry),
        (1, 1): fz * rx,
        (1, 2): fx * ry - fy * rx,
        (2, 0): fx,
        (2, 1): fy,
        (2, 2): fz,
    }.items():
        rotation[:, row, column] = value
    poses = np.zeros((len(positions_m), 4, 4))
    poses[:, :3, :3] = rotation
    poses[:, :3, 3] = -(rotation @ positions_m[:, :, None])[:, :, 0]
    poses[:, 3, 3] = 1.0
    return poses


def frustum_planes(positions_m: Floats, target_m: Floats, camera: CameraConfig) -> tuple[Floats, ...]:
    """Rows that turn points into scaled camera coordinates, for every candidate at once.

    Returns three (4, C) arrays ``x, y, z``: for homogeneous points ``q`` (P, 4), ``q @ z`` is the depth,
    and a point is in the image if and only if ``abs(q @ x) <= q @ z`` and ``abs(q @ y) <= q @ z``.
    (The principal point is the image's centre, so both tests are symmetric and imply a positive depth.)
    """
    poses = look_at_many(positions_m, target_m)[:, :3]  # (C, 3, 4)
    x = poses[:, 0] * (camera.focal_px / (camera.width_px / 2.0))
    y = poses[:, 1] * (camera.focal_px / (camera.height_px / 2.0))
    return np.ascontiguousarray(x.T), np.ascontiguousarray(y.T), np.ascontiguousarray(poses[:, 2].T)


def certainly_inside_radius(positions_m: Floats, target_m: Floats, camera: CameraConfig) -> float:
    """Radius (m) around the target within which every point is in the image of every candidate.

    The largest sphere around the target that touches no side of any candidate's frustum.
    """
    nearest = float(np.linalg.norm(positions_m - target_m, axis=1).min())
    half_px = min(camera.width_px, camera.height_px) / 2.0
    return nearest * half_px / float(np.hypot(half_px, camera.focal_px)) * (1.0 - 1e-9)


def in_frustum(points_m: Floats, positions_m: Floats, target_m: Floats, camera: CameraConfig) -> Bools:
    """(P, C): is each point in the image of the camera at each position, aimed at the target?

    Worked out in single precision, and again in double precision where a point comes within
    ``BORDER_M`` of the image's border: the result is that of double precision.

    Parameters
    ----------
    points_m, positions_m
        (P, 3) and (C, 3).
    target_m
        (3,) at which every camera aims.
    camera
        Its intrinsics.
    """
    x, y, z = frustum_planes(positions_m, target_m, camera)
    n_candidates = len(positions_m)
    visible = np.ones((len(points_m), n_candidates), dtype=bool)
    radius = certainly_inside_radius(positions_m, target_m, camera)
    offset = points_m - target_m
    ask = np.flatnonzero(np.einsum("ij,ij->i", offset, offset) > radius**2)
    # About the target the last components vanish or are distances: the fewest digits are lost.
    q32 = np.ones((len(ask), 4), dtype=np.float32)
    q32[:, :3] = offset[ask]
    at_target = np.append(target_m, 1.0)
    x32, y32, z32 = (
        np.concatenate([plane[:3], (at_target @ plane)[None]]).astype(np.float32) for plane in (x, y, z)
    )
    border = np.float32(BORDER_M * max(1.0, np.abs(x).max(), np.abs(y).max()))
    one, other = scratch(2, BLOCK, n_candidates)
    unsure = []  # flat indices into (ask, candidates)
    for start in range(0, len(ask), BLOCK):
        now = q32[start : start + BLOCK]
        side, above = one[: len(now)], other[: len(now)]
        np.abs(np.matmul(now, x32, out=side), out=side)
        np.abs(np.matmul(now, y32, out=above), out=above)
        np.maximum(side, above, out=side)
        margin = np.subtract(np.matmul(now, z32, out=above), side, out=above)
        visible[ask[start : start + BLOCK]] = margin >= 0
        np.abs(margin, out=margin)
        unsure.append(np.flatnonzero(margin < border) + start * n_candidates)
    # A few dozen of a million pairs, so all at once: block by block they would take half of the time.
    row, column = np.divmod(np.concatenate([*unsure, np.zeros(0, dtype=np.int64)]), n_candidates)
    if len(row):
        row = ask[row]
        q = np.ones((len(row), 4))
        q[:, :3] = points_m[row]
        exact = [np.einsum("ij,ji->i", q, plane[:, column]) for plane in (x, y, z)]
        visible[row, column] = np.maximum(np.abs(exact[0]), np.abs(exact[1])) <= exact[2]
    return visible
