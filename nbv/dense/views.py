"""What the stages of a dense reconstruction work on: photographs with poses, and what is sought in them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from nbv.config import CameraConfig, DenseConfig
from nbv.geometry.frames import angles_deg, camera_centers_m, directions_from, intrinsic_matrix
from nbv.geometry.matchability import nearest_views, stereo_partners
from nbv.types import Floats, Floats32

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
