"""What a renderer returns, and how radiance becomes 8-bit grey levels."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from nbv.geometry.frames import camera_center_m
from nbv.types import Floats, Floats32


class Renderer(Protocol):
    """All backends have this face and show the same scene."""

    name: str

    def rgb(self, camera_from_world: Floats) -> NDArray[np.uint8]:
        """Photograph (H, W, 3) of the scene by a camera at ``camera_from_world`` (4, 4), OpenCV axes, before sensor noise.

        Raises ``ValueError`` if the camera is not above the ground.
        """

    def close(self) -> None:
        """Give back what the operating system lent (a GL context); rendering afterwards is a mistake."""


def srgb_from_linear(radiance: NDArray[np.floating]) -> NDArray[np.floating]:
    """The sRGB transfer curve (IEC 61966-2-1), clipped to 0..1."""
    r = np.clip(radiance, 0.0, 1.0)
    return np.where(r <= 0.0031308, 12.92 * r, 1.055 * np.maximum(r, 1e-9) ** (1 / 2.4) - 0.055)


def linear_from_srgb(value: float) -> float:
    """Inverse of ``srgb_from_linear`` for one value in 0..1."""
    return value / 12.92 if value <= 0.04045 else ((value + 0.055) / 1.055) ** 2.4


_GREY_LEVELS = np.rint(255 * srgb_from_linear(np.arange(65536) / 65535.0)).astype(np.uint8)


def grey_levels(radiance: Floats32) -> NDArray[np.uint8]:
    """8-bit display values of linear radiance (1.0 is white), by table."""
    index = np.clip(radiance, 0.0, 1.0)
    index *= np.float32(65535.0)
    index += np.float32(0.5)
    return _GREY_LEVELS[index.astype(np.uint16)]


def camera_position(camera_from_world: Floats) -> Floats:
    """(3,) camera centre; ``ValueError`` for a matrix that is not (4, 4) or a camera not above z = 0."""
    matrix = np.asarray(camera_from_world, dtype=float)
    if matrix.shape != (4, 4) or not np.isfinite(matrix).all():
        raise ValueError(f"camera_from_world must be a finite (4, 4) matrix, got shape {matrix.shape}")
    position = camera_center_m(matrix)
    if position[2] <= 0.0:
        raise ValueError(f"the camera must be above the ground; its z is {position[2]:.3f} m")
    return position
