"""The true lens: where it shows what, and how light falls off. The vehicle assumes a pinhole (`CameraConfig`).

A renderer draws pinhole pictures only. So it draws one that is a little wider, with the true focal length, and what
the true principal point and distortion show is looked up in it.
"""

from __future__ import annotations

import dataclasses
import functools
import math

import cv2
import numpy as np

from nbv.config import CameraConfig, SensorConfig
from nbv.errors import UserError
from nbv.types import Floats, Floats32

WIDEST = 2.0  # largest factor by which a lens may draw the picture's corner in
RADII = 8001  # of the table that inverts the distortion; its error is below 1e-5 px
MARGIN_PX = 3  # for the cubic look-up


class Lens:
    """The true lens of a camera.

    The radial model is OpenCV's and COLMAP's: a ray at distance ``r`` from the axis (normalised) is seen at
    ``r * (1 + k1 r^2 + k2 r^4)``. Pixel centres are at half-integers.

    `UserError` where the distortion folds the picture over, or draws its corner in too far.
    """

    def __init__(self, camera: CameraConfig, sensor: SensorConfig) -> None:
        self._camera, self._sensor = camera, sensor
        self.focal_px = camera.focal_px * (1 + sensor.focal_error_percent / 100)
        self.is_pinhole = sensor.k1 == sensor.k2 == 0 and sensor.principal_point_error_px == (0, 0)
        right_px, down_px = sensor.principal_point_error_px
        corner = math.hypot(camera.width_px / 2 + abs(right_px), camera.height_px / 2 + abs(down_px))
        self._radii = np.linspace(0, WIDEST * corner / self.focal_px, RADII)
        self._seen_at = self._radii * (1 + sensor.k1 * self._radii**2 + sensor.k2 * self._radii**4)
        reached = np.flatnonzero(self._seen_at >= corner / self.focal_px)
        if not len(reached) or (np.diff(self._seen_at[: reached[0] + 1]) <= 0).any():
            raise UserError(
                f"sensor.k1={sensor.k1:g} and sensor.k2={sensor.k2:g} fold the picture over before its corner; "
                "take values nearer to 0"
            )
        self._radii, self._seen_at = self._radii[: reached[0] + 1], self._seen_at[: reached[0] + 1]

    @functools.cached_property
    def drawn(self) -> CameraConfig:
        """The pinhole camera that a renderer has to draw."""
        if self.is_pinhole:
            return dataclasses.replace(self._camera, focal_px=self.focal_px)
        x, y = self._rays
        width, height = (
            2 * (math.ceil(self.focal_px * float(np.abs(axis).max())) + MARGIN_PX) for axis in (x, y)
        )
        return CameraConfig(width, height, self.focal_px)

    def see(self, drawn: Floats32) -> Floats32:
        """(H, W, 3) what the lens shows of the picture ``drawn`` by a renderer; clipped by nothing."""
        if self.is_pinhole:
            return drawn
        across, down = self._look_up
        return cv2.remap(drawn, across, down, cv2.INTER_CUBIC).astype(np.float32, copy=False)

    @functools.cached_property
    def falloff(self) -> Floats32:
        """(H, W, 3) share of the light at each pixel: cosine to the 4th of the angle to the axis, to the power of
        ``vignetting``."""
        x, y = self._rays
        share = (1 + x**2 + y**2) ** (-2 * self._sensor.vignetting)
        return np.repeat(share.astype(np.float32)[..., None], 3, axis=2)

    @functools.cached_property
    def _rays(self) -> tuple[Floats, Floats]:
        """(H, W) normalised coordinates, right and down, of the ray that each pixel's centre sees."""
        camera, (right_px, down_px) = self._camera, self._sensor.principal_point_error_px
        x = (np.arange(camera.width_px) + 0.5 - camera.width_px / 2 - right_px) / self.focal_px
        y = (np.arange(camera.height_px) + 0.5 - camera.height_px / 2 - down_px) / self.focal_px
        seen_at = np.hypot(x, y[:, None])
        stretch = np.interp(seen_at, self._seen_at, self._radii) / np.maximum(seen_at, 1e-12)
        return x * stretch, y[:, None] * stretch

    @functools.cached_property
    def _look_up(self) -> tuple[Floats32, Floats32]:
        """(H, W) columns and rows of the drawn picture, as OpenCV counts them."""
        x, y = self._rays
        columns = x * self.focal_px + (self.drawn.width_px / 2 - 0.5)
        rows = y * self.focal_px + (self.drawn.height_px / 2 - 0.5)
        return columns.astype(np.float32), rows.astype(np.float32)
