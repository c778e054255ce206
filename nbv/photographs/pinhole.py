"""One pinhole camera for all photographs of a set, and pictures as it would have taken them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import cv2
import numpy as np
import pycolmap
from numpy.typing import NDArray

from nbv.config import CameraConfig

WIDEST = 0.3  # shortest focal length, as a share of the lens's own: of a fisheye that sees half the world


def common_pinhole(cameras: Sequence[pycolmap.Camera]) -> CameraConfig:
    """The pinhole of the most frequent camera's size, with the shortest focal length that its photographs fill."""
    keys = [camera.params_to_string() + f"{camera.model}{camera.width}x{camera.height}" for camera in cameras]
    camera = cameras[keys.index(Counter(keys).most_common(1)[0][0])]
    width, height = camera.width, camera.height
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    border = np.ones((height, width), dtype=bool)
    border[1:-1, 1:-1] = False
    at = np.column_stack([x[border], y[border]])
    rays = np.array(camera.cam_from_img(at))
    seen = camera.img_from_cam(np.column_stack([rays, np.ones(len(rays))]))
    ahead = np.abs(seen - at).max(axis=1) < 1  # else behind a pinhole: a fisheye sees farther
    # No pixel on the photograph's border lies within the pinhole's picture.
    inside = np.array([width - 1, height - 1]) / 2 / np.maximum(np.abs(rays[ahead]), 1e-9)
    focal_px = inside.min(axis=1).max(initial=WIDEST * camera.mean_focal_length())
    return CameraConfig(width, height, round(float(focal_px), 3))


def undistorted(
    pixels: NDArray[np.uint8], camera: pycolmap.Camera, pinhole: CameraConfig
) -> NDArray[np.uint8]:
    """(H, W, 3) or (H, W) the picture (H', W', ...) of a camera of its size, as the pinhole would have taken it.

    Black where the photograph does not reach. A mask, (H', W'), is not interpolated.
    """
    x, y = np.meshgrid(np.arange(pinhole.width_px) + 0.5, np.arange(pinhole.height_px) + 0.5)
    rays = np.stack([x - pinhole.width_px / 2, y - pinhole.height_px / 2], axis=-1) / pinhole.focal_px
    seen = camera.img_from_cam(np.dstack([rays, np.ones(x.shape)]).reshape(-1, 3)).reshape(*x.shape, 2)
    columns, rows = (seen - 0.5).astype(np.float32).transpose(2, 0, 1)
    mode = cv2.INTER_LINEAR if pixels.ndim == 3 else cv2.INTER_NEAREST
    return np.asarray(cv2.remap(pixels, columns, rows, mode, borderMode=cv2.BORDER_CONSTANT), np.uint8)
