"""The sections for what is simulated: camera, scene, sensor and flight."""

from __future__ import annotations

import math
from dataclasses import dataclass

from nbv.config.registry import RENDERERS
from nbv.config.section import Section
from nbv.config.sources import code, ours

LOWEST_SUN_DEG = 3.0  # lower, and shadows outgrow the ground that is drawn


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

    backend: str = ours("raycast", "renderer", why="gl (pyrender) needs EGL", names=RENDERERS.keys)
    sun_direction: tuple[float, float, float] = code(
        (0.001, 0.625, -0.78), "simulator", "direction the light travels, ENU"
    )
    sun_elevation_deg: float | None = ours(
        None,
        "height of the sun, 3 to 90; unset: that of `sun_direction`",
        why="the sun of the Moon and of the Earth; below 3° shadows outgrow the ground",
        added=True,
    )
    sun_azimuth_deg: float | None = ours(
        None,
        "where the sun stands, counter-clockwise from east; unset: as `sun_direction` has it",
        why="counted as viewpoints' azimuths are",
        added=True,
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
        name = "sun_direction" if self.sun_elevation_deg is None else "sun_elevation_deg"
        x, y, z = self.sun_direction
        elevation_deg = self.sun_elevation_deg
        if elevation_deg is None:
            elevation_deg = math.degrees(math.atan2(-z, math.hypot(x, y)))
        above = LOWEST_SUN_DEG <= elevation_deg <= 90.0
        self._need(above, name, f"a sun {LOWEST_SUN_DEG:g} to 90 degrees above the horizon")
        self._need(0 <= self.sky_grey <= 1, "sky_grey", "between 0 and 1")
        self._need_at_least(0, "sun_irradiance", "ambient", "read_noise_dn", "shot_noise_dn")
        self._need(self.sun_irradiance + self.ambient > 0, "ambient", "positive without a sun")

    @property
    def sun_travel(self) -> tuple[float, float, float]:
        """Direction the light travels (ENU, any length), of whichever fields say it."""
        if self.sun_elevation_deg is None and self.sun_azimuth_deg is None:
            return self.sun_direction
        x, y, z = self.sun_direction
        elevation, azimuth = math.atan2(-z, math.hypot(x, y)), math.atan2(-y, -x)
        if self.sun_elevation_deg is not None:
            elevation = math.radians(self.sun_elevation_deg)
        if self.sun_azimuth_deg is not None:
            azimuth = math.radians(self.sun_azimuth_deg)
        level = math.cos(elevation)
        return (-level * math.cos(azimuth), -level * math.sin(azimuth), -math.sin(elevation))


@dataclass(frozen=True)
class SensorConfig(Section):
    """What the true camera does that the vehicle does not know of (`nbv.scene.sensor`); nothing by default.

    Values, not draws, but for ``exposure_jitter_ev`` and the direction of the motion, which are drawn per photograph.
    """

    exposure_ev: float = ours(0.0, "exposure, in stops; 0 leaves it", why="cameras offer -3 to 3")
    exposure_jitter_ev: float = ours(
        0.0, "standard deviation of the exposure between photographs", why="automatic exposure steps by 1/3"
    )
    vignetting: float = ours(
        0.0, "light falls off as cosine to the power of 4 times this", why="1 is the law of a simple lens"
    )
    exposure_time_s: float = ours(
        0.0, "shutter time, for motion blur", why="1/250 is called the longest for drone surveys"
    )
    residual_speed_m_s: float = ours(
        0.0, "speed across the view at the photograph", why="PX4 holds position below 0.8 (MPC_HOLD_MAX_XY)"
    )
    residual_rate_deg_s: float = ours(
        0.0,
        "turning rate across the view at the photograph",
        why="gimbals specify ±0.01° of vibration: 3 °/s at 50 Hz",
    )
    jpeg_quality: int = ours(0, "1 to 100; 0: no compression", why="libjpeg's scale")
    focal_error_percent: float = ours(
        0.0,
        "true focal length above the one that the vehicle believes",
        why="0.2 between the two cameras of the EuRoC rig",
    )
    principal_point_error_px: tuple[float, float] = ours(
        (0.0, 0.0), "true principal point right of and below the centre", why="9 and 8 in EuRoC's camera 0"
    )
    k1: float = ours(
        0.0, "radial distortion, as OpenCV's and COLMAP's", why="-0.28 in EuRoC's camera 0, uncorrected"
    )
    k2: float = ours(0.0, "the same, fourth power", why="0.07 in EuRoC's camera 0, uncorrected")

    def __post_init__(self) -> None:
        self._need_at_least(0, "exposure_jitter_ev", "vignetting", "exposure_time_s")
        self._need_at_least(0, "residual_speed_m_s", "residual_rate_deg_s")
        self._need(0 <= self.jpeg_quality <= 100, "jpeg_quality", "1 to 100, or 0 for no compression")
        self._need(self.focal_error_percent > -100, "focal_error_percent", "above -100")


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
    planning_s: float = ours(
        0.0,
        "pause in the air while the model is updated and the next view planned",
        why="0: not counted; a vehicle's own time is that of its computer",
        added=True,
    )
    mass_kg: float = ours(2.06, "take-off mass, for the energy", why="PX4's Gazebo model x500", added=True)
    rotor_diameter_m: float = ours(
        0.279, "of each of four rotors, for the energy", why="PX4's Gazebo model x500", added=True
    )
    propulsion_efficiency: float = ours(
        0.6,
        "ideal over electrical power, for the energy",
        why="196 W in hover: 19 minutes of 80 % of a 4S pack of 5.2 Ah",
        added=True,
    )
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
        self._need_at_least(0, "takeoff_altitude_m", "arrival_tolerance_m", "settle_s", "planning_s")
        self._need_positive("mass_kg", "rotor_diameter_m", "propulsion_efficiency")
        self._need(self.propulsion_efficiency <= 1, "propulsion_efficiency", "at most 1")
        self._need_at_least(0, "keep_out_radius_m", "keep_out_height_m", "min_camera_altitude_m")
