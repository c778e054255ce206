"""One jerk-limited leg from hover to hover."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property, partial

import numpy as np
import ruckig

from nbv.config import FlightConfig
from nbv.errors import MissionFailure
from nbv.flight.wind import CALM, ground_speed_m_s
from nbv.geometry.frames import wrap_angle
from nbv.types import Floats, Point

SAMPLE_RATE_HZ = 5.0


@dataclass(frozen=True)
class Pose:
    """Where the vehicle hovers."""

    position_m: Point
    heading_rad: float  # counter-clockwise from east


@dataclass(frozen=True)
class Leg:
    """A flown piece of trajectory."""

    start: Pose
    end: Pose
    duration_s: float
    path_length_m: float
    # Distance along the line, and turn. Made anew for whoever draws it: Ruckig's objects, kept until the interpreter ends, make
    # it complain of leaks.
    trajectory: Callable[[], ruckig.Trajectory] = field(repr=False, compare=False)

    @cached_property  # most legs are never drawn
    def samples(self) -> Floats:
        """(K, 5): t (s, from the leg's start), x, y, z (m), heading (rad, in [-pi, pi)), at 5 Hz."""
        a, b = np.array(self.start.position_m), np.array(self.end.position_m)
        times = np.append(np.arange(0.0, self.duration_s, 1.0 / SAMPLE_RATE_HZ), self.duration_s)
        trajectory = self.trajectory()
        along = np.array([trajectory.at_time(float(t))[0] for t in times])  # (K, 2)
        length = self.path_length_m
        line = a + np.outer(along[:, 0], (b - a) / length if length > 0 else np.zeros(3))
        heading = wrap_angle(self.start.heading_rad + along[:, 1])
        return np.column_stack([times, line, heading])


def fly_straight(start: Pose, end: Pose, limits: FlightConfig, wind_m_s: tuple[float, float] = CALM) -> Leg:
    """Hover to hover along a straight line while turning the shorter way; time-optimal under the limits.

    Two synchronised axes: distance along the line and heading. Horizontal and vertical speed obey their
    own limits, acceleration and jerk theirs along the line; heading has its own rate, acceleration and
    jerk. The slower axis sets the duration. Wind (east, north) slows what goes against it (`nbv.flight.wind`).

    `MissionFailure` ``flight_failed``: no trajectory exists (does not happen for finite poses and positive limits).
    """
    a, b = np.array(start.position_m), np.array(end.position_m)
    length = float(np.linalg.norm(b - a))
    turn = float(wrap_angle(end.heading_rad - start.heading_rad))
    speed = _speed_along(b - a, length, limits, wind_m_s)
    trajectory = partial(_trajectory, length, turn, speed, limits)
    return Leg(start, end, float(trajectory().duration), length, trajectory)


def _trajectory(length: float, turn: float, speed: float, limits: FlightConfig) -> ruckig.Trajectory:
    request = ruckig.InputParameter(2)
    request.current_position, request.target_position = [0.0, 0.0], [length, turn]
    request.current_velocity = request.target_velocity = [0.0, 0.0]
    request.current_acceleration = request.target_acceleration = [0.0, 0.0]
    request.max_velocity = [speed, limits.max_yaw_rate_rad_s]
    request.max_acceleration = [limits.max_acceleration_m_s2, limits.max_yaw_acceleration_rad_s2]
    request.max_jerk = [limits.max_jerk_m_s3, limits.max_yaw_jerk_rad_s3]
    trajectory = ruckig.Trajectory(2)
    outcome = ruckig.Ruckig(2).calculate(request, trajectory)
    if outcome not in (ruckig.Result.Working, ruckig.Result.Finished):
        raise MissionFailure(
            "flight_failed", f"no trajectory over {length} m with a turn of {turn} rad: {outcome}"
        )
    return trajectory


def _speed_along(delta: Floats, length: float, limits: FlightConfig, wind_m_s: tuple[float, float]) -> float:
    """Largest speed on the line whose horizontal and vertical parts obey their limits."""
    if length == 0:
        return limits.max_speed_m_s
    horizontal = float(np.hypot(delta[0], delta[1])) / length
    vertical = abs(float(delta[2])) / length
    if horizontal > 0:
        east, north = (float(d) / (length * horizontal) for d in delta[:2])
        over_ground = ground_speed_m_s((east, north), limits, wind_m_s)
    return min(
        over_ground / horizontal if horizontal > 0 else np.inf,
        limits.max_climb_m_s / vertical if vertical > 0 else np.inf,
    )
