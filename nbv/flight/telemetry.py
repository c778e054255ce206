"""Where the camera really is when the vehicle's telemetry says where it is.

The vehicle flies, aims and plans by its own estimate of its pose. So the pose that it reports is the one that it
wanted, up to the arrival error, and what noise, drift, an uncorrected lever arm and attitude errors do is to put the
camera somewhere else. Only the renderer may ask where (`true_pose`); everything else in a mission gets the report.
"""

from __future__ import annotations

import math

import numpy as np
import scipy

from nbv.config import TelemetryConfig
from nbv.geometry.frames import invert_rigid
from nbv.process import keyed_rng
from nbv.types import Floats

_WAVES = 64


class TelemetryErrors:
    """The errors of one flight, drawn per (rock, replicate): a function of viewpoint and time, not of call order.

    The camera never sinks below ``min_altitude_m``, whatever the vehicle estimates.
    """

    def __init__(
        self, config: TelemetryConfig, rock_sha256: str, replicate: int, min_altitude_m: float
    ) -> None:
        self._config, self._key, self._min_altitude_m = config, (rock_sha256, replicate), min_altitude_m
        rng = keyed_rng("telemetry-drift", rock_sha256, replicate)
        # Random Fourier features of exp(-|t| / T): frequencies from its spectral density, Cauchy with scale 1 / T.
        self._frequencies = rng.standard_cauchy((3, _WAVES))
        self._phases = rng.uniform(0.0, 2.0 * math.pi, (3, _WAVES))

    def true_pose(self, reported: Floats, viewpoint_id: str, time_s: float) -> Floats:
        """(4, 4) true ``camera_from_world`` when ``reported`` (4, 4) is what telemetry says, ``time_s`` into the flight.

        With the level ``exact`` it is ``reported`` itself, to the bit.
        """
        if self._config.is_exact:
            return reported
        world_from_reported = invert_rigid(reported)
        normal = keyed_rng("telemetry", *self._key, viewpoint_id).standard_normal(6)
        c = self._config
        sd_m = np.array([c.horizontal_noise_m, c.horizontal_noise_m, c.vertical_noise_m])
        error_m = sd_m * normal[:3] + self.drift_m(time_s)
        # The vehicle is level and heads where the camera looks.
        forward = world_from_reported[:2, 2]
        east, north = forward / max(1e-12, float(np.linalg.norm(forward)))
        along, left, up = c.lever_arm_m
        lever_m = np.array([along * east - left * north, along * north + left * east, up])
        position_m = world_from_reported[:3, 3] - error_m + lever_m
        position_m[2] = max(position_m[2], self._min_altitude_m)
        about = np.deg2rad(c.attitude_noise_deg) * normal[3:]
        tilt = scipy.spatial.transform.Rotation.from_rotvec(about).as_matrix()
        true = np.eye(4)
        true[:3, :3] = tilt @ reported[:3, :3]
        true[:3, 3] = -true[:3, :3] @ position_m
        return true

    def drift_m(self, time_s: float) -> Floats:
        """(3,) slow error: a stationary process with standard deviation ``drift_m`` per axis whose values
        ``drift_time_s`` apart correlate by 1 / e."""
        angle = self._frequencies * (time_s / self._config.drift_time_s) + self._phases
        wave: Floats = self._config.drift_m * math.sqrt(2.0 / _WAVES) * np.cos(angle).sum(axis=1)
        return wave
