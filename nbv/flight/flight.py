"""A mission's flight log: take-off, legs, hovering, landing, with total time and path."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
import scipy

from nbv.config import FlightConfig, MissionConfig
from nbv.flight.leg import (
    CALM,
    J_PER_WH,
    Leg,
    Pose,
    fly_straight,
    leg_energy_wh,
    mean_wind_m_s,
    power_w,
    sway_m,
)
from nbv.geometry.frames import heading_to
from nbv.process import keyed_rng
from nbv.types import Floats, Point, Viewpoint

# Detours around the target: a straight leg must not pass through the rock.


MARGIN_M = 0.05  # detours keep this much more than the keep-out asks for


@dataclass(frozen=True)
class Cylinder:
    """Upright, from below the ground to its top."""

    center_m: tuple[float, float]
    radius_m: float
    top_m: float


def clear(a_m: Floats, b_m: Floats, keep_out: Cylinder) -> bool:
    """Does the segment a-b, (3,) each, stay out of the cylinder?"""
    a, b = np.asarray(a_m, dtype=float), np.asarray(b_m, dtype=float)
    t_low, t_high = 0.0, 1.0  # the part of the segment that is below the top
    rise = b[2] - a[2]
    if abs(rise) < 1e-12:
        if a[2] >= keep_out.top_m:
            return True
    else:
        crossing = (keep_out.top_m - a[2]) / rise
        t_low, t_high = (t_low, min(t_high, crossing)) if rise > 0 else (max(t_low, crossing), t_high)
        if t_low >= t_high:
            return True
    p, d = a[:2] - keep_out.center_m, (b - a)[:2]
    nearest = np.clip(-p @ d / max(d @ d, 1e-18), t_low, t_high)
    return bool(np.linalg.norm(p + nearest * d) >= keep_out.radius_m)


@dataclass(frozen=True)
class Airspace:
    """How a vehicle flies, and what it keeps out of."""

    limits: FlightConfig
    target_m: Point  # on the axis of the keep-out cylinder, whose size is among the limits
    wind_m_s: tuple[float, float] = CALM  # east and north

    @property
    def keep_out(self) -> Cylinder:
        """Around the target."""
        x, y, _ = self.target_m
        return Cylinder((x, y), self.limits.keep_out_radius_m, self.limits.keep_out_height_m)

    def straight(self, *poses: Pose) -> tuple[Leg, ...]:
        """Straight legs from pose to pose."""
        return tuple(fly_straight(p, q, self.limits, self.wind_m_s) for p, q in itertools.pairwise(poses))

    def route(self, start: Pose, end: Pose) -> tuple[Leg, ...]:
        """The legs from ``start`` to ``end``: one if the straight line is clear, else two; three straight over where none of these is.

        The detour passes left of, right of or over the keep-out cylinder (or its rim), whichever takes least time, with a
        short hover at the corner. Where an end itself lies inside the cylinder, it is one that this end is just outside of.
        """
        return _route(self, start, end)


@lru_cache(maxsize=2048)  # the seed orbit is the same in every mission on a (rock, replicate)
def _route(space: Airspace, start: Pose, end: Pose) -> tuple[Leg, ...]:
    a, b, keep_out = np.array(start.position_m), np.array(end.position_m), space.keep_out
    for inside in (p for p in (a, b) if not clear(p, p, keep_out)):
        away_m = float(np.linalg.norm(inside[:2] - keep_out.center_m))
        keep_out = replace(keep_out, radius_m=max(0.0, away_m - 1e-9))
    direct = space.straight(start, end)
    if clear(a, b, keep_out):
        return direct
    choices = [
        space.straight(start, pose_at(corner, heading), end)
        for corner, heading in _corners(a, b, keep_out, end.heading_rad)
        if clear(a, corner, keep_out) and clear(corner, b, keep_out)
    ]
    if choices:
        return min(choices, key=lambda legs: sum(leg.duration_s for leg in legs))
    # Straight up, across and straight down.
    top_m = max(start.position_m[2], end.position_m[2], keep_out.top_m + MARGIN_M)
    up, over = (pose_at(np.array([*p.position_m[:2], top_m]), end.heading_rad) for p in (start, end))
    return space.straight(start, up, over, end)


def pose_at(position_m: Floats, heading_rad: float) -> Pose:
    """Hovering at a position (3,)."""
    x, y, z = (float(v) for v in position_m)
    return Pose((x, y, z), heading_rad)


def _corners(a: Floats, b: Floats, keep_out: Cylinder, end_heading: float) -> list[tuple[Floats, float]]:
    """Corner positions and headings of the possible detours, `MARGIN_M` beyond the cylinder."""
    corners = []
    center, radius, height = (
        np.array(keep_out.center_m),
        keep_out.radius_m + MARGIN_M,
        keep_out.top_m + MARGIN_M,
    )
    start_xy, end_xy = a[:2] - center, b[:2] - center
    start_d, end_d = float(np.hypot(*start_xy)), float(np.hypot(*end_xy))
    around = min(radius, start_d, end_d)  # an end inside the margin but outside the keep-out has its own
    if around >= radius - MARGIN_M and around > 0:
        phi_start, phi_end = math.atan2(start_xy[1], start_xy[0]), math.atan2(end_xy[1], end_xy[0])
        for side in (1.0, -1.0):  # counter-clockwise, clockwise
            sweep = (side * (phi_end - phi_start)) % (2 * math.pi)
            # The two tangents touch the circle this far behind the start's and before the end's bearing.
            touch_start, touch_end = math.acos(around / start_d), sweep - math.acos(around / end_d)
            half = (touch_end - touch_start) / 2
            if not 0.0 <= half < math.radians(75.0):  # else the corner is absurdly far out
                continue
            bearing = phi_start + side * (touch_start + half)
            xy = around / math.cos(half) * np.array([math.cos(bearing), math.sin(bearing)])
            first, second = np.linalg.norm(xy - start_xy), np.linalg.norm(xy - end_xy)
            z = a[2] + (b[2] - a[2]) * first / (first + second)
            corner = np.array([*(center + xy), z])
            corners.append((corner, float(heading_to(xy + center, center))))

    # Over: above the middle of the chord through the cylinder, high enough where it enters and leaves.
    d = end_xy - start_xy
    length = float(np.hypot(*d))
    if length > 1e-9:
        unit = d / length
        middle = float(-start_xy @ unit)
        off = start_xy + middle * unit
        half_chord = math.sqrt(max(radius**2 - float(off @ off), 0.0))
        enter, leave = middle - half_chord, middle + half_chord
        if enter > 0 and leave < length:
            top = max(
                height,
                a[2] + (height - a[2]) * middle / enter,
                b[2] + (height - b[2]) * (length - middle) / (length - leave),
            )
            corners.append((np.array([*(center + off), top]), end_heading))
        # From above the cylinder to beside it, be that within the margin: out over the rim first, and the reverse.
        elif enter <= 0 and (leave < length or end_d >= radius - MARGIN_M):
            rim = start_xy + min(leave, length) * unit
            corners.append((np.array([*(center + rim), height]), end_heading))
        elif leave >= length and (enter > 0 or start_d >= radius - MARGIN_M):
            rim = start_xy + max(enter, 0.0) * unit
            corners.append((np.array([*(center + rim), height]), end_heading))
    return corners


SIGMAS_IN_TOLERANCE = 3.0


@dataclass(frozen=True)
class FlightEvent:
    """One thing the vehicle did, with the mission time at which it began."""

    name: str  # "take-off", a viewpoint's id, "return", "landing"
    start_s: float
    legs: tuple[Leg, ...]
    hover_s: float  # after the legs


class Flight:
    """The vehicle of one mission; ``rock_sha256`` and ``replicate`` are the key of its arrival errors.

    The camera is where the vehicle is, and the gimbal aims at the target, so arriving with a wrong
    position does not turn the target out of the image. ``flight_time_s`` counts everything from take-off to landing:
    climbs, legs and detours, ``settle_s`` before each photograph, and what `hover` waits for: while a view is planned,
    ``planning_s``.
    """

    def __init__(self, config: MissionConfig, rock_sha256: str, replicate: int) -> None:
        self._key = (rock_sha256, replicate)
        self._wind = config.wind
        self._space = Airspace(config.flight, config.target_m, mean_wind_m_s(config.wind, self._key))
        home = np.array(config.flight.home_m, dtype=float)
        self._pose = pose_at(home, float(heading_to(home, np.array(config.target_m))))
        self.flight_time_s = 0.0
        self.path_length_m = 0.0
        self.energy_wh = 0.0
        self.events: list[FlightEvent] = []

    def face(self, target_m: Point, limits: FlightConfig) -> None:
        """Head for a target there from now on and keep out of its cylinder; the limits may have other heights."""
        self._space = replace(self._space, target_m=target_m, limits=limits)

    @property
    def _limits(self) -> FlightConfig:
        return self._space.limits

    @property
    def position_m(self) -> Floats:
        """(3,) where the vehicle estimates to be."""
        return np.array(self._pose.position_m)

    @property
    def heading_rad(self) -> float:
        """Counter-clockwise from east."""
        return self._pose.heading_rad

    def take_off(self) -> None:
        """Climb from home to the take-off altitude."""
        x, y, z = self._pose.position_m
        up = Pose((x, y, z + self._limits.takeoff_altitude_m), self._pose.heading_rad)
        self._fly("take-off", self._space.straight(self._pose, up), 0.0)

    def fly_to(self, viewpoint: Viewpoint) -> Floats:
        """Fly to a viewpoint, around the rock if need be, and settle; returns the actual position (3,)."""
        arrived = arrival_position(viewpoint, self._limits, self._key)
        if self._wind.gust_m_s > 0:
            arrived += sway_m(self._wind, self._key, viewpoint.id)
            arrived[2] = max(arrived[2], self._limits.min_camera_altitude_m)
        end = pose_at(arrived, float(heading_to(arrived, np.array(self._space.target_m))))
        self._fly(viewpoint.id, self._space.route(self._pose, end), self._limits.settle_s)
        return arrived

    def hover(self, seconds: float) -> None:
        """Wait in the air."""
        self._fly("hover", (), seconds)

    def return_and_land(self) -> None:
        """Fly back above home and descend."""
        home = self._limits.home_m
        above = Pose((home[0], home[1], home[2] + self._limits.takeoff_altitude_m), self._pose.heading_rad)
        self._fly("return", self._space.route(self._pose, above), 0.0)
        down = Pose((home[0], home[1], home[2]), self._pose.heading_rad)
        self._fly("landing", self._space.straight(self._pose, down), 0.0)

    def samples(self) -> Floats:
        """(K, 5) t (s, mission time), x, y, z (m), heading (rad) of everything flown, at about 5 Hz."""
        parts = []
        for event in self.events:
            start_s = event.start_s
            for leg in event.legs:
                parts.append(leg.samples + np.array([start_s, 0.0, 0.0, 0.0, 0.0]))
                start_s += leg.duration_s
        return np.concatenate(parts) if parts else np.zeros((0, 5))

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON: totals, events, and the trajectory rounded to 0.1 ms, mm and mrad."""
        return {
            "flight_time_s": self.flight_time_s,
            "path_length_m": self.path_length_m,
            "energy_wh": self.energy_wh,
            "events": [
                {
                    "name": event.name,
                    "start_s": event.start_s,
                    "duration_s": sum(leg.duration_s for leg in event.legs),
                    "hover_s": event.hover_s,
                    "path_length_m": sum(leg.path_length_m for leg in event.legs),
                    "detour": len(event.legs) > 1,
                }
                for event in self.events
            ],
            "columns": ["t_s", "x_m", "y_m", "z_m", "heading_rad"],
            "samples": [
                [round(v, d) for v, d in zip(row, (4, 3, 3, 3, 3))] for row in self.samples().tolist()
            ],
        }

    def _fly(self, name: str, legs: tuple[Leg, ...], hover_s: float) -> None:
        self.events.append(FlightEvent(name, self.flight_time_s, legs, hover_s))
        self.flight_time_s += sum(leg.duration_s for leg in legs) + hover_s
        self.path_length_m += sum(leg.path_length_m for leg in legs)
        self.energy_wh += sum(leg_energy_wh(self._limits, leg) for leg in legs)
        self.energy_wh += power_w(self._limits) * hover_s / J_PER_WH
        if legs:
            self._pose = legs[-1].end


def arrival_position(viewpoint: Viewpoint, limits: FlightConfig, key: tuple[str, int]) -> Floats:
    """(3,) actual camera position (m) for a commanded viewpoint.

    The arrival test is a box of plus or minus ``arrival_tolerance_m`` per axis. A position controller
    does not use it up evenly: the error of each axis is normal with a third of the tolerance as standard
    deviation, truncated to the box. It is drawn per viewpoint and ``key``, (rock's SHA-256, replicate), so it does not
    depend on when or from where the viewpoint is flown to. Never below ``min_camera_altitude_m``.
    """
    uniform = keyed_rng("arrival", *key, viewpoint.id).random(3)
    edge = scipy.special.ndtr(-SIGMAS_IN_TOLERANCE)
    sigmas = scipy.special.ndtri(edge + uniform * (1.0 - 2.0 * edge))
    position: Floats = (
        np.array(viewpoint.position_m) + limits.arrival_tolerance_m / SIGMAS_IN_TOLERANCE * sigmas
    )
    position[2] = max(position[2], limits.min_camera_altitude_m)
    return position
