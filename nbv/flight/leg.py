"""One jerk-limited leg from hover to hover."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property, partial

import numpy as np
import ruckig

from nbv.config import FlightConfig, WindConfig
from nbv.errors import MissionFailure
from nbv.geometry.frames import wrap_angle
from nbv.process import keyed_rng
from nbv.types import Floats, Point

# Electrical energy of a flight, by momentum theory.
#
# A rotor disc of area A that carries the weight T accelerates air of density rho to v_h = sqrt(T / (2 rho A)) in hover; in a
# climb at v its ideal power is
#
#     P(v) = T (v / 2 + sqrt((v / 2)^2 + v_h^2))
#
# (Leishman, Principles of Helicopter Aerodynamics, 2nd ed., section 2.13). In a descent slower than 2 v_h, the vortex-ring
# state, momentum theory does not hold; it counts as hover. So does level flight: its induced power is 3 % less at 2 m/s, the
# mean of a short leg, and a sixth less at 5 m/s, of which drag takes back a part. Rotors, motors and controllers turn electrical into
# ideal power with one efficiency. Avionics and camera are not in it.


GRAVITY_M_S2 = 9.81
AIR_KG_M3 = 1.225  # sea level, 15 degrees: ISO 2533
ROTORS = 4
J_PER_WH = 3600.0


def power_w(vehicle: FlightConfig, climb_m_s: float = 0.0) -> float:
    """Electrical power in hover, or in a climb; a descent counts as hover."""
    weight_n = vehicle.mass_kg * GRAVITY_M_S2
    disc_m2 = ROTORS * math.pi * (vehicle.rotor_diameter_m / 2) ** 2
    half = max(0.0, climb_m_s) / 2
    ideal_w = weight_n * (half + math.sqrt(half**2 + weight_n / (2 * AIR_KG_M3 * disc_m2)))
    return ideal_w / vehicle.propulsion_efficiency


def leg_energy_wh(vehicle: FlightConfig, leg: Leg) -> float:
    """Of one leg, at its mean climb rate."""
    if leg.duration_s <= 0:
        return 0.0
    climb_m_s = (leg.end.position_m[2] - leg.start.position_m[2]) / leg.duration_s
    return power_w(vehicle, climb_m_s) * leg.duration_s / J_PER_WH


# Wind on the flight: a steady horizontal wind of one direction, and gusts that push the hovering vehicle about.
#
# What gusts blur in a photograph is `nbv.config.SensorConfig`'s ``residual_speed_m_s``.


CALM = (0.0, 0.0)
VERTICAL_GUST = 0.5  # of a horizontal one: MIL-F-8785C, sigma_w / sigma_u = 0.177 ** 0.4 at the ground


def mean_wind_m_s(wind: WindConfig, key: tuple[str, int]) -> tuple[float, float]:
    """Where the air moves, east and north; the bearing is uniform, drawn per ``key``, (rock's SHA-256, replicate)."""
    if wind.mean_speed_m_s == 0:
        return CALM
    bearing = keyed_rng("wind", *key).uniform(0, 2 * math.pi)
    return wind.mean_speed_m_s * math.cos(bearing), wind.mean_speed_m_s * math.sin(bearing)


def sway_m(wind: WindConfig, key: tuple[str, int], viewpoint_id: str) -> Floats:
    """(3,) how far gusts have pushed the vehicle at a photograph, beyond the arrival error.

    A gust u moves a vehicle with rotor drag k and a position loop of stiffness w**2 by k u / w**2, ``sway_s`` times u.
    """
    normal = keyed_rng("gust", *key, viewpoint_id).standard_normal(3)
    return wind.gust_m_s * wind.sway_s * normal * (1.0, 1.0, VERTICAL_GUST)


def ground_speed_m_s(
    direction: tuple[float, float], limits: FlightConfig, wind_m_s: tuple[float, float]
) -> float:
    """Largest horizontal speed along the unit vector ``direction``.

    ``max_speed_m_s`` limits the speed over ground, as autopilots have it, and the speed through the air too: across
    the wind the vehicle leans into it, against it there is less left, with it nothing is gained.
    """
    if wind_m_s == CALM:
        return limits.max_speed_m_s
    along = wind_m_s[0] * direction[0] + wind_m_s[1] * direction[1]
    across = wind_m_s[0] * direction[1] - wind_m_s[1] * direction[0]
    return min(limits.max_speed_m_s, along + math.sqrt(limits.max_speed_m_s**2 - across**2))


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
    jerk. The slower axis sets the duration. Wind (east, north) slows what goes against it (`nbv.flight.leg`).

    `MissionFailure` ``flight_failed``: no trajectory exists (does not happen for finite poses and positive limits).
    """
    a, b = np.array(start.position_m), np.array(end.position_m)
    length = float(np.linalg.norm(b - a))
    turn = float(wrap_angle(end.heading_rad - start.heading_rad))
    # The largest whose horizontal and vertical parts obey their limits.
    speed = limits.max_speed_m_s
    if length > 0:
        across, up = float(np.hypot(*(b - a)[:2])) / length, abs(float(b[2] - a[2])) / length
        speeds = [limits.max_climb_m_s / up] if up > 0 else []
        if across > 0:
            east, north = (float(d) / (length * across) for d in (b - a)[:2])
            speeds.append(ground_speed_m_s((east, north), limits, wind_m_s) / across)
        speed = min(speeds)
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
