"""How well the vehicle knows where its camera and its target are."""

from __future__ import annotations

import math
from dataclasses import dataclass

from nbv.config.section import Section
from nbv.config.sources import ours
from nbv.errors import UserError


@dataclass(frozen=True)
class TelemetryConfig(Section):
    """Errors of the reported camera pose (`nbv.flight.telemetry`); all zero by default: telemetry is exact."""

    horizontal_noise_m: float = ours(
        0.0, "standard deviation of each horizontal axis, anew in every photograph"
    )
    vertical_noise_m: float = ours(0.0, "the same of the vertical axis")
    drift_m: float = ours(0.0, "standard deviation of the slow error of each axis")
    drift_time_s: float = ours(120.0, "time in which the slow error forgets itself (correlation 1 / e)")
    lever_arm_m: tuple[float, float, float] = ours(
        (0.0, 0.0, 0.0), "camera from the reported point that nobody corrects: forward, left, up"
    )
    attitude_noise_deg: float = ours(0.0, "standard deviation of the camera's attitude about each axis")

    def __post_init__(self) -> None:
        self._need_at_least(0, "horizontal_noise_m", "vertical_noise_m", "drift_m", "attitude_noise_deg")
        self._need_positive("drift_time_s")
        if not self.is_exact:
            rule = "positive, or drift_m: telemetry that errs needs a covariance along every axis"
            for name in ("horizontal_noise_m", "vertical_noise_m"):
                self._need(getattr(self, name) > 0 or self.drift_m > 0, name, rule)

    @property
    def is_exact(self) -> bool:
        """Whether what is reported is the truth."""
        return self.position_sd_m == 0 and self.attitude_noise_deg == 0

    @property
    def covariance_m2(self) -> tuple[float, float, float]:
        """Variance of the reported position along east, north and up: noise and drift.

        The lever arm is no part of it: nobody knows of one that nobody corrects.
        """
        horizontal, vertical = self.horizontal_noise_m**2, self.vertical_noise_m**2
        return (horizontal + self.drift_m**2, horizontal + self.drift_m**2, vertical + self.drift_m**2)

    @property
    def position_sd_m(self) -> float:
        """Root mean square distance between the reported and the true camera position."""
        noise = 2 * self.horizontal_noise_m**2 + self.vertical_noise_m**2 + 3 * self.drift_m**2
        return math.sqrt(noise + sum(axis**2 for axis in self.lever_arm_m))


@dataclass(frozen=True)
class TargetConfig(Section):
    """Error of the place where the target is believed before it is seen; zero by default: it is known."""

    horizontal_sd_m: float = ours(
        0.0,
        "standard deviation of each horizontal axis of the target's believed centre",
        why="0.5: a pixel of the best lunar orbital images (LROC NAC)",
    )
    vertical_sd_m: float = ours(0.0, "the same of the vertical axis", why="as horizontal_sd_m")

    def __post_init__(self) -> None:
        self._need_at_least(0, "horizontal_sd_m", "vertical_sd_m")

    @property
    def is_known(self) -> bool:
        """Whether what is believed is the truth."""
        return self.horizontal_sd_m == 0 and self.vertical_sd_m == 0


# Fixed RTK is specified to 1 cm plus 1 ppm horizontally and about 1.5 times that vertically (u-blox ZED-F9P data sheet);
# twice that is taken for a vehicle in motion. Single-frequency GNSS with a flight controller's filter: about 0.5 m over
# minutes. Visual-inertial odometry: sub-percent drift of the way flown (150 to 300 m here) between loop closures.
TELEMETRY_LEVELS = {
    "exact": TelemetryConfig(),
    "rtk": TelemetryConfig(horizontal_noise_m=0.02, vertical_noise_m=0.03, attitude_noise_deg=0.5),
    "gnss": TelemetryConfig(
        horizontal_noise_m=0.3, vertical_noise_m=0.4, drift_m=0.4, drift_time_s=300.0, attitude_noise_deg=1.0
    ),
    "vio": TelemetryConfig(
        horizontal_noise_m=0.02,
        vertical_noise_m=0.02,
        drift_m=0.2,
        drift_time_s=120.0,
        attitude_noise_deg=0.5,
    ),
}


def telemetry_level(name: str) -> TelemetryConfig:
    """The level called ``name``; ``UserError`` if there is none."""
    if name not in TELEMETRY_LEVELS:
        raise UserError(f"unknown telemetry level {name!r}; there are {', '.join(TELEMETRY_LEVELS)}")
    return TELEMETRY_LEVELS[name]
