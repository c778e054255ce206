"""The true camera: lens, exposure, motion, noise and compression between the scene and a photograph.

In the order of a camera: light through the lens, vignetting and exposure, motion blur (all in linear light), then noise,
8 bits, JPEG. What is drawn at random is keyed by what is photographed: the same view is the same photograph in every
mission.
"""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from nbv.config import CameraConfig, MissionConfig, SceneConfig
from nbv.random_streams import keyed_rng
from nbv.rocks.texture import linear_from_srgb
from nbv.scene.lens import Lens
from nbv.scene.view import Renderer, grey_levels
from nbv.types import Floats, Floats32

_RADIANCE = linear_from_srgb(np.arange(256) / 255).astype(np.float32)
_SAMPLES_PER_PX = 32  # along a streak
NEAREST_M = 0.1  # a target nearer than this, or behind the camera, blurs as if it were there


class Sensor:
    """The true camera, of which the vehicle knows a pinhole; `UserError` for a lens that cannot be (`nbv.scene.lens.Lens`)."""

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
        streak_px = self._streak_px(camera_from_world, rng.uniform(0, 2 * math.pi, 2))
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

    def _streak_px(self, camera_from_world: Floats, directions_rad: Floats) -> Floats:
        """(2,) way of the target's image while the shutter is open: across by ``f v t / depth``, and turned by
        ``f w t``, each in a direction of its own."""
        c = self._config
        depth_m = max(NEAREST_M, float(camera_from_world[2, :3] @ self._target_m + camera_from_world[2, 3]))
        open_px = self._lens.focal_px * c.exposure_time_s
        lengths_px = open_px * np.array([c.residual_speed_m_s / depth_m, math.radians(c.residual_rate_deg_s)])
        streak: Floats = lengths_px @ np.stack([np.cos(directions_rad), np.sin(directions_rad)], axis=1)
        return streak


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
