"""The sections for what is simulated: camera, scene and flight."""

from __future__ import annotations

from dataclasses import dataclass

from nbv.config.registry import RENDERERS
from nbv.config.section import Section
from nbv.config.sources import code, ours


@dataclass(frozen=True)
class CameraConfig(Section):
    """Pinhole camera without distortion; pixel centres at half-integers, as in COLMAP."""

    width_px: int = code(640, "simulator", "image width")
    height_px: int = code(480, "simulator", "image height")
    focal_px: float = code(
        465.7412, "simulator, 1.204 rad of view", "focal length, known and shared by all photographs"
    )

    def __post_init__(self) -> None:
        self._need_at_least(16, "width_px", "height_px")
        self._need_positive("focal_px")


@dataclass(frozen=True)
class SceneConfig(Section):
    """Light, ground and sensor."""

    backend: str = ours("raycast", "renderer", why="gl needs a display or EGL", names=RENDERERS.keys)
    sun_direction: tuple[float, float, float] = code(
        (0.001, 0.625, -0.78), "simulator", "direction the light travels, ENU"
    )
    sun_irradiance: float = code(0.904, "simulator", "brightness of the sun, relative")
    ambient: float = code(0.4, "simulator", "brightness of the sky, relative")
    sky_grey: float = code(0.7, "simulator", "grey of the background, 0 to 1")
    ground_seed: int = ours(0, "which procedural ground")
    read_noise_dn: float = ours(
        1.0, "Gaussian noise of the sensor, 8-bit digital numbers", why="the simulator has none"
    )
    shot_noise_dn: float = ours(
        1.5,
        "standard deviation at full scale; grows with the square root of the signal",
        why="the simulator has none",
    )

    def __post_init__(self) -> None:
        self._need(self.sun_direction[2] < 0, "sun_direction", "downward (negative third component)")
        self._need(0 <= self.sky_grey <= 1, "sky_grey", "between 0 and 1")
        self._need_at_least(0, "sun_irradiance", "ambient", "read_noise_dn", "shot_noise_dn")
        self._need(self.sun_irradiance + self.ambient > 0, "ambient", "positive without a sun")


@dataclass(frozen=True)
class FlightConfig(Section):
    """X500-class multirotor limits and the paper's arrival test."""

    home_m: tuple[float, float, float] = ours(
        (0.0, -8.0, 0.0), "take-off point, ENU", why="8 m away as in the public code, from the south"
    )
    takeoff_altitude_m: float = code(3.0, "mission file", "altitude after take-off")
    max_speed_m_s: float = ours(5.0, "top speed", why="X500 class")
    max_climb_m_s: float = ours(2.0, "top climb rate", why="X500 class")
    max_acceleration_m_s2: float = ours(3.0, "acceleration limit", why="X500 class")
    max_jerk_m_s3: float = ours(8.0, "jerk limit", why="X500 class")
    max_yaw_rate_rad_s: float = ours(0.8, "yaw rate limit", why="X500 class")
    max_yaw_acceleration_rad_s2: float = ours(1.5, "yaw acceleration limit", why="X500 class")
    max_yaw_jerk_rad_s3: float = ours(6.0, "yaw jerk limit", why="X500 class")
    arrival_tolerance_m: float = code(0.35, "arrival test", "largest error of arrival, per axis")
    settle_s: float = code(2.0, "mission file", "pause before a photograph")
    keep_out_radius_m: float = ours(
        1.3,
        "upright cylinder around the target that straight legs go round",
        why="the public code flies through",
    )
    keep_out_height_m: float = ours(2.2, "its top, above the ground", why="the public code flies through")
    min_camera_altitude_m: float = ours(0.3, "arrival errors never take the camera below")

    def __post_init__(self) -> None:
        self._need_positive("max_speed_m_s", "max_climb_m_s", "max_acceleration_m_s2", "max_jerk_m_s3")
        self._need_positive("max_yaw_rate_rad_s", "max_yaw_acceleration_rad_s2", "max_yaw_jerk_rad_s3")
        self._need_at_least(0, "takeoff_altitude_m", "arrival_tolerance_m", "settle_s")
        self._need_at_least(0, "keep_out_radius_m", "keep_out_height_m", "min_camera_altitude_m")
