"""Detours around the target: a straight leg must not pass through the rock."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from nbv.config import FlightConfig
from nbv.flight.leg import Leg, Pose, fly_straight
from nbv.flight.wind import CALM
from nbv.geometry.frames import heading_to
from nbv.types import Floats, Point

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
    return min(choices, key=_duration_s) if choices else _over(space, start, end, keep_out.top_m + MARGIN_M)


def _over(space: Airspace, start: Pose, end: Pose, top_m: float) -> tuple[Leg, ...]:
    """Straight up, across and straight down."""
    top_m = max(start.position_m[2], end.position_m[2], top_m)
    up, over = (pose_at(np.array([*p.position_m[:2], top_m]), end.heading_rad) for p in (start, end))
    return space.straight(start, up, over, end)


def _duration_s(legs: tuple[Leg, ...]) -> float:
    return sum(leg.duration_s for leg in legs)


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
