"""Depth of one view from rectified pairs with its neighbours (OpenCV semi-global matching).

Geometry of a pair: both images are rotated to one orientation whose x axis is the baseline from the
reference to the neighbour, so the reference is always the left image, and whose z axis points at the
target. Both are shifted so that the target has zero disparity at the centre of the crop:
``disparity = focal * baseline * (1 / Z - 1 / Z_target)``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np
import scipy
from numpy.typing import NDArray

from nbv.config import CameraConfig, DenseConfig
from nbv.geometry.frames import angles_deg, camera_centers_m, directions_from, intrinsic_matrix
from nbv.geometry.visibility import nearest_views, stereo_partners
from nbv.types import Floats, Floats32, Ints

# What the stages of a dense reconstruction work on: photographs with poses, and what is sought in them.


Image = NDArray[np.uint8]  # (H, W, 3) RGB


@dataclass(frozen=True)
class PosedViews:
    """Photographs with known poses of one target; `nbv.dense.stereo` and its siblings take everything from here."""

    images: Mapping[str, Image]  # (H, W, 3) by name
    camera_from_world: Mapping[str, Floats]  # (4, 4) rigid, by the same names, metres
    camera: CameraConfig  # known intrinsics of all
    target_m: tuple[float, float, float] | Floats  # (3,) the point that the cameras aim at
    config: DenseConfig
    surface_m: Floats | None = None  # (N, 3) points near which the surface lies; None: anywhere in the crop

    @property
    def target(self) -> Floats:
        """(3,) ``target_m`` as an array."""
        return np.asarray(self.target_m, dtype=float)

    @cached_property
    def grey(self) -> dict[str, NDArray[np.uint8]]:
        """(H, W) by name."""
        return {n: cv2.cvtColor(i, cv2.COLOR_RGB2GRAY).astype(np.uint8) for n, i in self.images.items()}

    def center_m(self, name: str) -> Floats:
        """(3,) camera centre in the world frame."""
        return camera_centers_m(self.camera_from_world[name])

    @cached_property
    def _names(self) -> list[str]:
        return sorted(self.camera_from_world)

    @cached_property
    def _angles_deg(self) -> Floats:
        """(V, V) between the directions to the views, in the order of their names, as seen from the target."""
        directions = directions_from(self.target, np.array([self.center_m(name) for name in self._names]))
        return angles_deg(directions, directions)

    def baseline_angles_deg(self) -> Floats:
        """(V, V) angles, 0 to 90, between the line through two cameras and the line from their midpoint to the target."""
        centers_m = np.array([self.center_m(name) for name in self._names])
        a, b = centers_m[:, None], centers_m[None]
        baseline, gaze = b - a, self.target - (a + b) / 2
        along = np.abs((baseline * gaze).sum(axis=-1))
        return np.rad2deg(np.arctan2(np.linalg.norm(np.cross(baseline, gaze), axis=-1), along))

    @cached_property
    def neighbours(self) -> dict[str, list[str]]:
        """Of each view the others for stereo with it, best first: `stereo_partners`, less views one behind the other."""
        beside = self.baseline_angles_deg() >= self.config.min_baseline_angle_deg
        chosen = zip(*stereo_partners(self._angles_deg, self.config, beside))
        names = self._names
        return {name: [names[k] for k in row[usable]] for name, (row, usable) in zip(names, chosen)}

    @cached_property
    def source_views(self) -> dict[str, list[str]]:
        """Of each view the ``config.consistency_views`` others nearest in viewing direction as seen from the target."""
        nearest = nearest_views(self._angles_deg, self.config.consistency_views)
        return {name: [self._names[k] for k in row] for name, row in zip(self._names, nearest)}

    def shrunk(self) -> PosedViews:
        """The same at a long side of at most ``config.max_size_px``."""
        camera = shrunk_camera(self.camera, self.config.max_size_px)
        return replace(self, images={n: shrunk(i, camera) for n, i in self.images.items()}, camera=camera)


# A dense backend makes a depth map of every view that has a neighbour, in sorted name order. Each is (H, W): metres along
# the optical axis, NaN where unknown. With `PosedViews.surface_m` it may leave out what is not near these points.
DepthMaps = dict[str, Floats32]
DenseBackend = Callable[[PosedViews], DepthMaps]


def pixel_matrix(camera: CameraConfig) -> Floats:
    """(3, 3) K for array indices: pixel centres at integers, half a pixel off COLMAP's convention."""
    matrix = intrinsic_matrix(camera)
    matrix[:2, 2] -= 0.5
    return matrix


def shrunk_camera(camera: CameraConfig, max_size_px: int) -> CameraConfig:
    """The camera of photographs whose long side is at most ``max_size_px``; 0: the camera itself."""
    size_px = max(camera.width_px, camera.height_px)
    if not 0 < max_size_px < size_px:
        return camera
    width_px, height_px = (
        round(side * max_size_px / size_px) for side in (camera.width_px, camera.height_px)
    )
    return CameraConfig(width_px, height_px, camera.focal_px * width_px / camera.width_px)


def shrunk(image: Image, camera: CameraConfig) -> Image:
    """The photograph (H, W, 3) at the size of ``camera``; the photograph itself where it has it."""
    size = (camera.width_px, camera.height_px)
    if (image.shape[1], image.shape[0]) == size:
        return image
    return cv2.resize(image, size, interpolation=cv2.INTER_AREA).astype(np.uint8, copy=False)


# Geometric consistency: a depth is kept when enough other views' depth maps confirm it.


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


# Depth in flight: all photographs so far at a quarter of their pixels, for a planner and not for a cloud.


PARTNERS = 2  # of each photograph
AGREEING_VIEWS = 2
STRIDE_PX = 2  # between the places that are kept, in rows and columns


def coarse_depth(views: PosedViews, sparse_points_m: Floats) -> tuple[Floats, Ints]:
    """Places (K, 3) of the confirmed depths, and by whose depth they are (K,): indices into the names, in the order of the poses.

    Depths are sought near the points (N, 3) of the sparse model.
    """
    size_px = max(views.camera.width_px, views.camera.height_px) // 2
    config = replace(views.config, max_size_px=size_px, neighbours=PARTNERS, agreeing_views=AGREEING_VIEWS)
    surface_m = points_to_search(sparse_points_m, views.target_m, config)
    views = replace(views, config=config, surface_m=surface_m).shrunk()
    names, places, of = list(views.camera_from_world), [np.zeros((0, 3))], [np.zeros(0, dtype=np.int64)]
    for name, depth_m in check_consistency(sgbm_depth_maps(views), views).items():
        points = backproject(depth_m, views.camera)[::STRIDE_PX, ::STRIDE_PX].reshape(-1, 3).astype(float)
        points = points[np.isfinite(points).all(axis=1)]
        pose = views.camera_from_world[name]
        places.append((points - pose[:3, 3]) @ pose[:3, :3])
        of.append(np.full(len(points), names.index(name)))
    return np.concatenate(places), np.concatenate(of)


MERGE_RELATIVE_DEPTH = 0.01  # neighbours' depths within 1 % of each other are one surface
_BLOCK_PX = 3  # 5 loses 0.5 to 1.2 points of F-score at 16 mm (15016, 24 + 8 views)
_MIN_DEPTH_M = 0.3
_MAX_INTERPOLATION_JUMP_PX = 1.0  # beyond this between adjacent disparities there is an edge
SEARCH_MARGIN_M = 0.15  # from the points of the sparse model to where depths are still sought
_SMALLEST_WINDOW_PX = 16  # SGBM needs more than a block
_COMPANIONS = 3
_FEWEST_POINTS = 100  # fewer say nothing about where the surface ends


def sgbm_depth_maps(
    views: PosedViews, workers: int = 1, tell: Callable[[int], None] = lambda done: None
) -> DepthMaps:
    """The dense backend ``sgbm``: OpenCV's StereoSGBM, deterministic; ``tell`` gets the number of views that are done."""
    cv2.setNumThreads(1)
    partners = {name: chosen for name in sorted(views.images) if (chosen := views.neighbours[name])}
    _ = views.grey  # made before threads ask for it
    maps = {}
    with ThreadPoolExecutor(workers) as pool:
        estimates = pool.map(lambda name: estimate_depth(views, name, partners[name]), partners)
        for name, depth_m in zip(partners, estimates, strict=True):
            maps[name] = depth_m
            tell(len(maps))
    return maps


def estimate_depth(views: PosedViews, name: str, neighbours: Sequence[str]) -> Floats32:
    """Depth map (H, W) of the view ``name``, metres, NaN where unknown, from ``neighbours`` (best first)."""
    camera = views.camera
    depth = np.full((camera.height_px, camera.width_px), np.nan, dtype=np.float32)
    window = target_window(views, name)
    if window is None or not neighbours:
        return depth
    x0, y0, x1, y1 = window
    estimates = [_pair_depth(views, name, other, window) for other in neighbours]
    depth[y0:y1, x0:x1] = merge_estimates(np.stack(estimates))
    return depth


def points_to_search(
    sparse_points_m: Floats, target_m: tuple[float, float, float] | Floats, config: DenseConfig
) -> Floats | None:
    """Points (M, 3) of the sparse model (N, 3) inside the crop around the target, wrong ones left out.

    A point without three others within `SEARCH_MARGIN_M` is taken for a wrong match: it would stretch what is
    searched. The tip of a thin rock has companions. ``None`` if fewer than 100 points are left.
    """
    points = np.asarray(sparse_points_m, dtype=float)
    away_m = np.abs(points - np.asarray(target_m, dtype=float)).max(axis=1, initial=0.0)
    points = points[away_m <= config.crop_half_width_m]
    if len(points) < _FEWEST_POINTS:
        return None
    tree = scipy.spatial.cKDTree(points)
    nearest = tree.query(points, k=_COMPANIONS + 1, distance_upper_bound=SEARCH_MARGIN_M)[0]
    points = points[np.isfinite(nearest[:, -1])]
    return points if len(points) >= _FEWEST_POINTS else None


def target_window(views: PosedViews, name: str) -> tuple[int, int, int, int] | None:
    """Pixel window ``x0, y0, x1, y1`` (ends excluded) of the target's surroundings in a view, or None if unseen."""
    camera, pose = views.camera, views.camera_from_world[name]
    target = pose[:3, :3] @ views.target + pose[:3, 3]
    if target[2] <= _MIN_DEPTH_M:
        return None
    u, v, _ = pixel_matrix(camera) @ target / target[2]
    half = camera.focal_px * views.config.crop_half_width_m / target[2]
    x0, x1 = max(0, int(u - half)), min(camera.width_px, int(u + half) + 1)
    y0, y1 = max(0, int(v - half)), min(camera.height_px, int(v + half) + 1)
    return (x0, y0, x1, y1) if x0 < x1 and y0 < y1 else None


def _pair_depth(views: PosedViews, name: str, other: str, window: tuple[int, int, int, int]) -> Floats32:
    """Depth of a view's window from one rectified pair, NaN where unknown.

    With ``views.surface_m`` only the part of the rectified images and the disparities around these points are matched:
    `SEARCH_MARGIN_M` beyond them.
    """
    camera, target, config = views.camera, views.target, views.config
    camera_from_world = views.camera_from_world[name]
    center, other_center = views.center_m(name), views.center_m(other)
    x0, y0, x1, y1 = window
    unknown = np.full((y1 - y0, x1 - x0), np.nan, dtype=np.float32)
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
    if views.surface_m is not None:
        points = (views.surface_m - center) @ rectified_from_world.T
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
    for view, where in ((name, center), (other, other_center)):
        rotation = views.camera_from_world[view][:3, :3]
        image_from_rectified = (
            matrix @ rotation @ rectified_from_world.T @ np.linalg.inv(rectified_matrix(where))
        )
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        warped.append(
            cv2.warpPerspective(views.grey[view], image_from_rectified, (width, height), flags=flags)
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
