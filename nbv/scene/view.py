"""What a renderer returns, and how radiance becomes 8-bit grey levels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from nbv.types import Bools, Floats, Floats32


@dataclass(frozen=True, eq=False)
class RenderedView:
    """A noiseless photograph with its ground truth (for tests and evaluation, never for planning)."""

    rgb: NDArray[np.uint8]  # (H, W, 3) before sensor noise
    depth_m: Floats32  # (H, W) distance along the optical axis at the pixel centre; inf is sky
    rock_mask: Bools  # (H, W) True where the pixel's centre sees the rock


class Renderer(Protocol):
    """All backends have this face and show the same scene."""

    name: str

    def render(self, camera_from_world: Floats) -> RenderedView:
        """Photograph the scene with a camera at ``camera_from_world`` (4, 4), OpenCV axes.

        Raises ``ValueError`` if the camera is not above the ground.
        """

    def rgb(self, camera_from_world: Floats) -> NDArray[np.uint8]:
        """The picture (H, W, 3) of ``render`` alone, where the rest is not needed."""

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
    position = -matrix[:3, :3].T @ matrix[:3, 3]
    if position[2] <= 0.0:
        raise ValueError(f"the camera must be above the ground; its z is {position[2]:.3f} m")
    return position
