"""The true camera: lens, exposure, motion, noise and compression between the scene and a photograph.

In the order of a camera: light through the lens, vignetting and exposure, motion blur (all in linear light), then noise,
8 bits, JPEG. What is drawn at random is keyed by what is photographed: the same view is the same photograph in every
mission.
"""

from __future__ import annotations

import dataclasses
import functools
import math

import cv2
import numpy as np
from numpy.typing import NDArray

from nbv.config import CameraConfig, MissionConfig, SceneConfig, SensorConfig
from nbv.errors import UserError
from nbv.process import keyed_rng
from nbv.rocks.texture import linear_from_srgb
from nbv.scene.view import Renderer, grey_levels
from nbv.types import Floats, Floats32

# The true lens: where it shows what, and how light falls off. The vehicle assumes a pinhole (`CameraConfig`).
#
# A renderer draws pinhole pictures only. So it draws one that is a little wider, with the true focal length, and what
# the true principal point and distortion show is looked up in it.


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


_RADIANCE = linear_from_srgb(np.arange(256) / 255).astype(np.float32)
_SAMPLES_PER_PX = 32  # along a streak
NEAREST_M = 0.1  # a target nearer than this, or behind the camera, blurs as if it were there


class Sensor:
    """The true camera, of which the vehicle knows a pinhole; `UserError` for a lens that cannot be (`nbv.scene.sensor.Lens`)."""

    def __init__(self, config: MissionConfig) -> None:
        self._scene, self._config = config.scene, config.sensor
        self._target_m = np.array(config.target_m)
        self._lens = Lens(config.camera, config.sensor)

    @property
    def drawn(self) -> CameraConfig:
        """The pinhole camera that the renderer has to have."""
        return self._lens.drawn

    def photograph(
        self, renderer: Renderer, camera_from_world: Floats, key: tuple[str, int, str]
    ) -> NDArray[np.uint8]:
        """(H, W, 3) RGB seen from ``camera_from_world`` (4, 4), where the camera really is; a function of its arguments alone.

        ``renderer`` draws the scene with the camera `drawn`; ``key``, (rock's SHA-256, replicate, viewpoint's id), is that of
        the random draws.
        """
        image = self.exposed(
            renderer.rgb(camera_from_world), camera_from_world, keyed_rng("exposure and motion", *key)
        )
        image = add_sensor_noise(image, self._scene, keyed_rng("sensor noise", *key))
        return compressed(image, self._config.jpeg_quality) if self._config.jpeg_quality else image

    def exposed(
        self, drawn: NDArray[np.uint8], camera_from_world: Floats, rng: np.random.Generator
    ) -> NDArray[np.uint8]:
        """(H, W, 3) the picture ``drawn`` by a renderer after lens, exposure and motion, in 8 bits."""
        c = self._config
        stops = c.exposure_ev + c.exposure_jitter_ev * rng.standard_normal()
        # The target's image moves while the shutter is open: across by ``f v t / depth``, and turned by ``f w t``, each in a
        # direction of its own.
        directions_rad = rng.uniform(0, 2 * math.pi, 2)
        depth_m = max(NEAREST_M, float(camera_from_world[2, :3] @ self._target_m + camera_from_world[2, 3]))
        open_px = self._lens.focal_px * c.exposure_time_s
        lengths_px = open_px * np.array([c.residual_speed_m_s / depth_m, math.radians(c.residual_rate_deg_s)])
        streak_px = lengths_px @ np.stack([np.cos(directions_rad), np.sin(directions_rad)], axis=1)
        moves = bool(streak_px.any())
        if self._lens.is_pinhole and stops == 0 and c.vignetting == 0 and not moves:
            return drawn
        light = self._lens.see(cv2.LUT(drawn, _RADIANCE).astype(np.float32, copy=False))
        if c.vignetting:
            light = light * self._lens.falloff
        if stops:
            light = light * np.float32(2.0**stops)
        if moves:
            # A sensor saturates after the shutter closes: a bright streak is not cut off before.
            light = cv2.filter2D(light, -1, streak_kernel(streak_px), borderType=cv2.BORDER_REPLICATE).astype(
                np.float32, copy=False
            )
        return grey_levels(light)


def streak_kernel(streak_px: Floats) -> Floats32:
    """(K, K) weights, K odd, of a point that moves by ``streak_px`` (right, down) at constant speed; sum 1."""
    samples = _SAMPLES_PER_PX * max(1, math.ceil(float(np.abs(streak_px).max())))
    along = (np.arange(samples) + 0.5) / samples - 0.5
    half = max(1, math.ceil(float(np.abs(streak_px).max()) / 2))
    kernel = np.zeros((2 * half + 1, 2 * half + 1))
    column, row = (along * length + half for length in streak_px)
    c0, r0 = (np.minimum(axis.astype(int), 2 * half - 1) for axis in (column, row))
    for dr in (0, 1):
        for dc in (0, 1):
            weight = (1 - np.abs(row - r0 - dr)) * (1 - np.abs(column - c0 - dc))
            np.add.at(kernel, (r0 + dr, c0 + dc), weight / samples)
    return kernel.astype(np.float32)


def compressed(image: NDArray[np.uint8], quality: int) -> NDArray[np.uint8]:
    """(H, W, 3) RGB after JPEG at ``quality``, 1 to 100."""
    _, data = cv2.imencode(
        ".jpg", cv2.cvtColor(image, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, quality]
    )
    decoded = cv2.cvtColor(cv2.imdecode(data, cv2.IMREAD_COLOR), cv2.COLOR_BGR2RGB)
    return decoded.astype(np.uint8, copy=False)


def add_sensor_noise(
    rgb: NDArray[np.uint8], config: SceneConfig, rng: np.random.Generator
) -> NDArray[np.uint8]:
    """(H, W, 3) with Gaussian read noise and signal-dependent shot noise, rounded and clipped.

    The variance of a value v is ``read_noise_dn**2 + shot_noise_dn**2 * v / 255``, independent per
    pixel and channel.
    """
    levels = np.arange(256, dtype=np.float32)
    deviation = np.sqrt(config.read_noise_dn**2 + config.shot_noise_dn**2 * levels / 255).astype(np.float32)
    noisy = rng.standard_normal(rgb.shape, dtype=np.float32)
    noisy *= deviation[rgb]
    noisy += rgb
    np.rint(noisy, out=noisy)
    return np.clip(noisy, 0, 255, out=noisy).astype(np.uint8)
