"""Depth of one view from rectified pairs with its neighbours (OpenCV semi-global matching).

Every function here is pure: the depth map of a reference view depends on its own image and pose, on its
neighbours' and on the configuration, and on nothing else, so it can be cached under these.

Geometry of a pair: both images are rotated to one orientation whose x axis is the baseline from the
reference to the neighbour, so the reference is always the left image, and whose z axis points at the
target. Both are shifted so that the target has zero disparity at the centre of the crop:
``disparity = focal * baseline * (1 / Z - 1 / Z_target)``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import cv2
import numpy as np

from nbv.config import CameraConfig, DenseConfig
from nbv.dense.interface import Floats32, Image
from nbv.geometry.frames import intrinsic_matrix
from nbv.geometry.matchability import usable_angles
from nbv.types import Floats

MERGE_RELATIVE_DEPTH = 0.01  # neighbours' depths within 1 % of each other are one surface
_BLOCK_PX = 3  # 5 loses 0.5 to 1.2 points of F-score at 16 mm (15016, 24 + 8 views)
_MIN_DEPTH_M = 0.3
_MAX_INTERPOLATION_JUMP_PX = 1.0  # beyond this between adjacent disparities there is an edge
SEARCH_MARGIN_M = 0.15  # from the points of the sparse model to where depths are still sought
_SMALLEST_WINDOW_PX = 16  # SGBM needs more than a block


def pixel_matrix(camera: CameraConfig) -> Floats:
    """(3, 3) K for array indices: pixel centres at integers, half a pixel off COLMAP's convention."""
    matrix = intrinsic_matrix(camera)
    matrix[:2, 2] -= 0.5
    return matrix


def camera_center_m(camera_from_world: Floats) -> Floats:
    """(3,) camera centre in the world frame."""
    return -camera_from_world[:3, :3].T @ camera_from_world[:3, 3]


def viewing_angle_deg(center_a_m: Floats, center_b_m: Floats, target_m: Floats) -> float:
    """Angle at the target between the directions to two cameras (the triangulation angle)."""
    a, b = center_a_m - target_m, center_b_m - target_m
    cosine = a @ b / (np.linalg.norm(a) * np.linalg.norm(b))
    return float(np.rad2deg(np.arccos(np.clip(cosine, -1.0, 1.0))))


def choose_neighbours(
    reference: str,
    camera_from_world: Mapping[str, Floats],
    target_m: tuple[float, float, float] | Floats,
    config: DenseConfig,
) -> list[str]:
    """Up to ``config.neighbours`` other views for stereo with ``reference``, best first.

    Usable views lie between ``min_pair_angle_deg`` and ``max_pair_angle_deg`` away as seen from the
    target; the best angle is ``best_pair_angle_deg``, and a factor off it costs the same either way
    (too narrow: imprecise; too wide: different looks). Ties are broken by name. A view less than
    ``min_baseline_angle_deg`` off the line to the target, in front or behind, is not usable.

    Parameters
    ----------
    reference
        Name of the view.
    camera_from_world
        (4, 4) of all views by name, metres.
    target_m
        (3,) the point that the cameras aim at.
    config
        Its ``neighbours`` and limits on angles.
    """
    target = np.asarray(target_m, dtype=float)
    center = camera_center_m(camera_from_world[reference])
    scored = []
    for name in sorted(camera_from_world):
        if name == reference:
            continue
        other = camera_center_m(camera_from_world[name])
        angle = viewing_angle_deg(center, other, target)
        if usable_angles(angle, config):
            scored.append((abs(np.log(angle / config.best_pair_angle_deg)), name, other))
    chosen: list[str] = []
    for _, name, other in sorted(scored, key=lambda entry: entry[:2]):
        if len(chosen) == config.neighbours:
            break
        if baseline_angle_deg(center, other, target) >= config.min_baseline_angle_deg:
            chosen.append(name)
    return chosen


def baseline_angle_deg(center_a_m: Floats, center_b_m: Floats, target_m: Floats) -> float:
    """Angle, 0 to 90, between the line through two cameras and the line from their midpoint to the target."""
    baseline, gaze = center_b_m - center_a_m, target_m - (center_a_m + center_b_m) / 2
    return float(np.rad2deg(np.arctan2(np.linalg.norm(np.cross(baseline, gaze)), abs(baseline @ gaze))))


def estimate_depth(
    image: Image,
    camera_from_world: Floats,
    neighbours: Sequence[tuple[Image, Floats]],
    camera: CameraConfig,
    target_m: tuple[float, float, float] | Floats,
    config: DenseConfig,
    surface_m: Floats | None = None,
) -> Floats32:
    """Depth map (H, W) of one view, metres, NaN where unknown.

    Parameters
    ----------
    image, camera_from_world
        The reference view.
    neighbours
        Images and poses to match it with, best first.
    surface_m
        (N, 3) points near which the surface lies (see `nbv.dense.surface.points_to_search`); ``None``: it may lie
        anywhere in the crop.
    """
    roi = target_window(camera_from_world, camera, target_m, config)
    depth = np.full((camera.height_px, camera.width_px), np.nan, dtype=np.float32)
    if roi is None or not neighbours:
        return depth
    grey = _grey(image)
    estimates = [
        pair_depth(grey, camera_from_world, _grey(other), pose, camera, target_m, config, roi, surface_m)
        for other, pose in neighbours
    ]
    x0, y0, x1, y1 = roi
    depth[y0:y1, x0:x1] = merge_estimates(np.stack(estimates))
    return depth


def target_window(
    camera_from_world: Floats,
    camera: CameraConfig,
    target_m: tuple[float, float, float] | Floats,
    config: DenseConfig,
) -> tuple[int, int, int, int] | None:
    """Pixel window ``x0, y0, x1, y1`` (ends excluded) of the target's surroundings, or None if unseen.

    Parameters
    ----------
    camera_from_world
        (4, 4) of the view.
    camera
        Its intrinsics.
    target_m
        (3,) the point that the cameras aim at.
    config
        Its ``crop_half_width_m``.
    """
    target = camera_from_world[:3, :3] @ np.asarray(target_m, dtype=float) + camera_from_world[:3, 3]
    if target[2] <= _MIN_DEPTH_M:
        return None
    u, v, _ = pixel_matrix(camera) @ target / target[2]
    half = camera.focal_px * config.crop_half_width_m / target[2]
    x0, x1 = max(0, int(u - half)), min(camera.width_px, int(u + half) + 1)
    y0, y1 = max(0, int(v - half)), min(camera.height_px, int(v + half) + 1)
    return (x0, y0, x1, y1) if x0 < x1 and y0 < y1 else None


def pair_depth(
    grey: np.ndarray,
    camera_from_world: Floats,
    other_grey: np.ndarray,
    other_from_world: Floats,
    camera: CameraConfig,
    target_m: tuple[float, float, float] | Floats,
    config: DenseConfig,
    roi: tuple[int, int, int, int],
    surface_m: Floats | None = None,
) -> Floats32:
    """Depth of the reference's window ``roi`` from one rectified pair, NaN where unknown.

    With ``surface_m`` (N, 3) only the part of the rectified images and the disparities around these points are
    matched: `SEARCH_MARGIN_M` beyond them.

    Parameters
    ----------
    grey, camera_from_world
        The reference (H, W) and its pose (4, 4).
    other_grey, other_from_world
        The neighbour and its pose.
    camera
        Known intrinsics of both.
    target_m
        (3,) the point that the cameras aim at.
    config
        Its ``crop_half_width_m``.
    roi
        Window ``x0, y0, x1, y1`` of the reference, ends excluded.
    surface_m
        (N, 3) points near which the surface lies; ``None``: anywhere in the crop.
    """
    x0, y0, x1, y1 = roi
    unknown = np.full((y1 - y0, x1 - x0), np.nan, dtype=np.float32)
    target = np.asarray(target_m, dtype=float)
    center, other_center = camera_center_m(camera_from_world), camera_center_m(other_from_world)
    baseline = float(np.linalg.norm(other_center - center))
    x_axis = (other_center - center) / max(baseline, 1e-12)
    gaze = target - (center + other_center) / 2
    z_axis = gaze - (gaze @ x_axis) * x_axis
    target_depth = float(np.linalg.norm(z_axis))  # the same in both cameras
    nearest, farthest = target_depth - config.crop_half_width_m, target_depth + config.crop_half_width_m
    if baseline < 1e-6 or target_depth < _MIN_DEPTH_M:
        return unknown
    nearest = max(nearest, _MIN_DEPTH_M)
    z_axis /= target_depth
    rectified_from_world = np.stack([x_axis, np.cross(z_axis, x_axis), z_axis])

    focal = camera.focal_px
    half = round(focal * config.crop_half_width_m / target_depth)
    left, top, right, bottom = -half, -half, half, half  # of the crop; the target is at (0, 0)
    if surface_m is not None:
        points = (surface_m - center) @ rectified_from_world.T
        points = points[points[:, 2] > nearest]
        if len(points) == 0:
            return unknown
        nearest = max(nearest, float(points[:, 2].min()) - SEARCH_MARGIN_M)
        farthest = min(farthest, float(points[:, 2].max()) + SEARCH_MARGIN_M)
        x_target, y_target, _ = rectified_from_world @ (target - center) / target_depth
        columns = focal * (points[:, 0] / points[:, 2] - x_target)
        rows = focal * (points[:, 1] / points[:, 2] - y_target)
        margin = focal * SEARCH_MARGIN_M / target_depth
        left, right = max(left, int(columns.min() - margin)), min(right, int(columns.max() + margin) + 1)
        top, bottom = max(top, int(rows.min() - margin)), min(bottom, int(rows.max() + margin) + 1)
        if right - left < _SMALLEST_WINDOW_PX or bottom - top < _SMALLEST_WINDOW_PX or nearest >= farthest:
            return unknown
    scale = focal * baseline
    lowest = int(np.floor(scale * (1 / farthest - 1 / target_depth)))
    highest = int(np.ceil(scale * (1 / nearest - 1 / target_depth)))
    count = 16 * int(np.ceil((highest - lowest + 1) / 16))
    # SGBM gives no disparity where the partner may fall outside; real image content is padded there.
    left_pad, right_pad = max(lowest + count, 0), max(-lowest, 0)
    width, height = right - left + left_pad + right_pad, bottom - top

    def rectified_matrix(camera_center: Floats) -> Floats:
        x, y, z = rectified_from_world @ (target - camera_center)
        return np.array(
            [[focal, 0, left_pad - left - focal * x / z], [0, focal, -top - focal * y / z], [0, 0, 1]]
        )

    matrix = pixel_matrix(camera)
    warped = []
    for source, pose, where in (
        (grey, camera_from_world, center),
        (other_grey, other_from_world, other_center),
    ):
        image_from_rectified = (
            matrix @ pose[:3, :3] @ rectified_from_world.T @ np.linalg.inv(rectified_matrix(where))
        )
        warped.append(
            cv2.warpPerspective(
                source, image_from_rectified, (width, height), flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
            )
        )
    matcher = cv2.StereoSGBM.create(
        minDisparity=lowest,
        numDisparities=count,
        blockSize=_BLOCK_PX,
        P1=8 * _BLOCK_PX**2,
        P2=32 * _BLOCK_PX**2,
        disp12MaxDiff=1,
        uniquenessRatio=5,
        speckleWindowSize=60,
        speckleRange=2,
        mode=cv2.STEREO_SGBM_MODE_SGBM_3WAY,
    )
    disparity = matcher.compute(*warped).astype(np.float32) / 16.0
    invalid = np.float32(lowest - 10_000)  # so low that no interpolated value with a share of it is valid
    disparity[disparity < lowest] = invalid

    rectified_from_pixel = (
        rectified_matrix(center)
        @ rectified_from_world
        @ camera_from_world[:3, :3].T
        @ np.linalg.inv(matrix)
        @ np.array([[1.0, 0, x0], [0, 1, y0], [0, 0, 1]])
    )
    size = (x1 - x0, y1 - y0)
    smooth, sharp = (
        cv2.warpPerspective(
            disparity,
            rectified_from_pixel,
            size,
            flags=mode | cv2.WARP_INVERSE_MAP,
            borderMode=cv2.BORDER_CONSTANT,
            borderValue=float(invalid),
        )
        for mode in (cv2.INTER_LINEAR, cv2.INTER_NEAREST)
    )
    valid = (smooth >= lowest) & (np.abs(smooth - sharp) <= _MAX_INTERPOLATION_JUMP_PX)

    # Depth along the rectified z axis, then along the reference's: a pixel's ray has depth component
    # `slope` in the rectified frame per metre of depth in the reference.
    rectified_depth = 1.0 / np.where(valid, smooth / np.float32(scale) + np.float32(1 / target_depth), 1.0)
    row = (rectified_from_world @ camera_from_world[:3, :3].T @ np.linalg.inv(matrix))[2]
    slope = (row[0] * np.arange(x0, x1) + (row[1] * np.arange(y0, y1) + row[2])[:, None]).astype(np.float32)
    valid &= (rectified_depth >= nearest) & (rectified_depth <= farthest) & (slope > 0)
    return np.where(valid, rectified_depth / np.where(valid, slope, 1.0), np.nan).astype(np.float32)


def merge_estimates(estimates: Floats32) -> Floats32:
    """One depth per pixel from several estimates (K, H, W), best first; NaN where none is known.

    The estimate with most others within 1 % wins (ties: the first), and is averaged with these.
    """
    if len(estimates) == 1:
        return estimates[0]
    best_support = np.zeros(estimates.shape[1:], dtype=np.int8)
    merged = np.full(estimates.shape[1:], np.nan, dtype=np.float32)
    known = np.nan_to_num(estimates, nan=0.0)  # 0 supports nothing: depths are positive
    for estimate in known:
        agrees = np.abs(known - estimate) < MERGE_RELATIVE_DEPTH * estimate
        support = agrees.sum(axis=0, dtype=np.int8)
        better = support > best_support
        mean = np.where(agrees, known, 0.0).sum(axis=0) / np.maximum(support, 1)
        merged[better] = mean[better]
        best_support = np.maximum(best_support, support)
    return merged


def backproject(
    depth_m: Floats32, camera: CameraConfig, window: tuple[int, int, int, int] | None = None
) -> Floats32:
    """Camera-frame points (h, w, 3) of a depth map (H, W), or of its window ``y0, y1, x0, x1``."""
    y0, y1, x0, x1 = window or (0, depth_m.shape[0], 0, depth_m.shape[1])
    matrix = pixel_matrix(camera)
    depth = depth_m[y0:y1, x0:x1]
    x = ((np.arange(x0, x1) - matrix[0, 2]) / matrix[0, 0]).astype(np.float32)
    y = ((np.arange(y0, y1) - matrix[1, 2]) / matrix[1, 1]).astype(np.float32)
    return np.stack([depth * x, depth * y[:, None], depth], axis=-1)


def depth_normals(points_m: Floats32) -> Floats32:
    """Unit normals (H, W, 3) of a grid of camera-frame points, towards the camera.

    Central differences; NaN where the pixel or one of its four neighbours has no depth.
    """
    horizontal, vertical = np.full_like(points_m, np.nan), np.full_like(points_m, np.nan)
    horizontal[:, 1:-1] = points_m[:, 2:] - points_m[:, :-2]
    vertical[1:-1] = points_m[2:] - points_m[:-2]
    normal = np.cross(vertical, horizontal)
    normal[~np.isfinite(points_m[..., 2])] = np.nan
    length = np.sqrt(_dot(normal, normal))
    normal /= np.where(length > 0, length, np.nan)[..., None]
    normal[_dot(normal, points_m) > 0] *= -1.0
    return normal


def _dot(a: Floats32, b: Floats32) -> Floats32:
    """(...) dot products of (..., 3) vectors; three times as fast as a sum along the last axis, with the same bits."""
    product = a * b
    return product[..., 0] + product[..., 1] + product[..., 2]


def _grey(image: Image) -> np.ndarray:
    return cv2.cvtColor(image, cv2.COLOR_RGB2GRAY) if image.ndim == 3 else image
