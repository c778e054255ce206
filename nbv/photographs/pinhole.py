"""One pinhole camera for all photographs of a set, and pictures as it would have taken them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from functools import lru_cache

import cv2
import numpy as np
import pycolmap
from numpy.typing import NDArray

from nbv.config import CameraConfig
from nbv.types import Floats

_WIDEST, _NARROWEST = 0.3, 4.0  # focal lengths that are tried, as a share of the lens's own
_STEPS = 40


def common_pinhole(cameras: Sequence[pycolmap.Camera]) -> CameraConfig:
    """The pinhole of the most frequent camera's size, with the shortest focal length that its photographs fill."""
    keys = [camera.params_to_string() + f"{camera.model}{camera.width}x{camera.height}" for camera in cameras]
    camera = cameras[keys.index(Counter(keys).most_common(1)[0][0])]
    focal = float(camera.mean_focal_length())
    low, high = _WIDEST * focal, _NARROWEST * focal
    for _ in range(_STEPS):
        middle = (low + high) / 2
        low, high = (low, middle) if _fills(camera, middle) else (middle, high)
    return CameraConfig(int(camera.width), int(camera.height), round(high, 3))


def undistorted(
    pixels: NDArray[np.uint8], camera: pycolmap.Camera, pinhole: CameraConfig
) -> NDArray[np.uint8]:
    """(H, W, 3) or (H, W) the picture (H', W', ...) of a camera of its size, as the pinhole would have taken it.

    Black where the photograph does not reach. A mask, (H', W'), is not interpolated.
    """
    maps = _look_up(camera.model_name, camera.width, camera.height, camera.params_to_string(), pinhole)
    mode = cv2.INTER_LINEAR if pixels.ndim == 3 else cv2.INTER_NEAREST
    return cv2.remap(pixels, *maps, mode, borderMode=cv2.BORDER_CONSTANT, borderValue=0).astype(np.uint8)


def _fills(camera: pycolmap.Camera, focal_px: float) -> bool:
    """Whether every pixel on the border of a pinhole of the camera's size lies within the camera's picture."""
    width, height = camera.width, camera.height
    x, y = np.arange(width) + 0.5, np.arange(height) + 0.5
    border = np.concatenate(
        [
            *(np.stack([x, np.full(width, edge)], axis=1) for edge in (0.5, height - 0.5)),
            *(np.stack([np.full(height, edge), y], axis=1) for edge in (0.5, width - 0.5)),
        ]
    )
    seen = _seen_at((border - [width / 2, height / 2]) / focal_px, camera)
    return bool(((seen >= 0.499) & (seen <= [width - 0.499, height - 0.499])).all())  # centres of pixels


@lru_cache(maxsize=8)
def _look_up(
    model: str, width: int, height: int, params: str, pinhole: CameraConfig
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """(H, W) columns and rows of the photograph for every pixel of the pinhole, as OpenCV counts them."""
    values = [float(value) for value in params.split(",")]
    camera = pycolmap.Camera(model=model, width=width, height=height, params=values)
    x, y = np.meshgrid(np.arange(pinhole.width_px) + 0.5, np.arange(pinhole.height_px) + 0.5)
    rays = (np.stack([x, y], axis=-1) - [pinhole.width_px / 2, pinhole.height_px / 2]) / pinhole.focal_px
    seen = (_seen_at(rays.reshape(-1, 2), camera) - 0.5).astype(np.float32).reshape(*x.shape, 2)
    return np.ascontiguousarray(seen[..., 0]), np.ascontiguousarray(seen[..., 1])


def _seen_at(rays: Floats, camera: pycolmap.Camera) -> Floats:
    """(K, 2) pixels of rays (K, 2); NaN compares false where the lens does not show one."""
    seen = np.asarray(camera.img_from_cam(np.column_stack([rays, np.ones(len(rays))])), dtype=float)
    return seen.reshape(-1, 2)
