"""Detours around the target: a straight leg must not pass through the rock."""

from __future__ import annotations

import itertools
import math
from functools import lru_cache

import numpy as np

from nbv.config import FlightConfig
from nbv.flight.leg import Leg, Pose, fly_straight
from nbv.flight.wind import CALM
from nbv.geometry.frames import heading_to
from nbv.terrain import Cylinder
from nbv.types import Floats

MARGIN_M = 0.05  # detours keep this much more than the keep-out asks for


def clear(a_m: Floats, b_m: Floats, target_m: Floats, radius_m: float, height_m: float) -> bool:
    """Does the segment a-b stay out of the upright cylinder around the target, from below to ``height_m``?

    Parameters
    ----------
    a_m, b_m
        (3,) ends of the segment.
    target_m
        (3,) on the cylinder's axis.
    radius_m, height_m
        Of the cylinder; the height above z = 0.
    """
    a, b = np.asarray(a_m, dtype=float), np.asarray(b_m, dtype=float)
    t_low, t_high = 0.0, 1.0  # the part of the segment that is below height_m
    rise = b[2] - a[2]
    if abs(rise) < 1e-12:
        if a[2] >= height_m:
            return True
    else:
        crossing = (height_m - a[2]) / rise
        t_low, t_high = (t_low, min(t_high, crossing)) if rise > 0 else (max(t_low, crossing), t_high)
        if t_low >= t_high:
            return True
    p, d = a[:2] - np.asarray(target_m)[:2], (b - a)[:2]
    nearest = np.clip(-p @ d / max(d @ d, 1e-18), t_low, t_high)
    return bool(np.linalg.norm(p + nearest * d) >= radius_m)


def route(
    start: Pose,
    end: Pose,
    target_m: tuple[float, float, float],
    limits: FlightConfig,
    wind_m_s: tuple[float, float] = CALM,
    obstacles: tuple[Cylinder, ...] = (),
) -> list[Leg]:
    """The legs from ``start`` to ``end``: one if the straight line is clear, else two.

    The detour passes left of, right of or over the keep-out cylinder (or its rim), whichever takes least time, with a
    short hover at the corner. If an end itself lies inside the cylinder there is nothing to go around:
    the leg is flown straight.

    With ``obstacles``, from which to stay out too, the detour is the fastest such one around any of them that is clear of
    all; where there is none the vehicle climbs above them, crosses and descends.

    Parameters
    ----------
    start, end
        Hovering poses.
    target_m
        On the axis of the keep-out cylinder.
    limits
        The vehicle, and size of that cylinder.
    wind_m_s
        East and north.
    obstacles
        Other cylinders to stay out of.
    """
    legs = _route(start, end, target_m, limits, wind_m_s)
    return list(_among(legs, target_m, limits, wind_m_s, obstacles) if obstacles else legs)


@lru_cache(maxsize=2048)  # the seed orbit is the same in every mission on a (rock, replicate)
def _route(
    start: Pose,
    end: Pose,
    target_m: tuple[float, float, float],
    limits: FlightConfig,
    wind_m_s: tuple[float, float],
) -> tuple[Leg, ...]:
    target = np.array(target_m)
    a, b = np.array(start.position_m), np.array(end.position_m)
    radius, height = limits.keep_out_radius_m, limits.keep_out_height_m
    direct = (fly_straight(start, end, limits, wind_m_s),)
    if clear(a, b, target, radius, height):
        return direct

    choices = []
    for corner, heading in _corners(a, b, target, radius + MARGIN_M, height + MARGIN_M, end.heading_rad):
        if clear(a, corner, target, radius, height) and clear(corner, b, target, radius, height):
            middle = _pose(corner, heading)
            choices.append(_through(wind_m_s, limits, start, middle, end))
    return min(choices, key=_duration_s, default=direct)


def _among(
    legs: tuple[Leg, ...],
    target_m: tuple[float, float, float],
    limits: FlightConfig,
    wind_m_s: tuple[float, float],
    obstacles: tuple[Cylinder, ...],
) -> tuple[Leg, ...]:
    """``legs`` where they are clear of the obstacles, else a detour."""
    start, end = legs[0].start, legs[-1].end
    a, b = np.array(start.position_m), np.array(end.position_m)
    target = (np.array(target_m), limits.keep_out_radius_m, limits.keep_out_height_m)
    around = [target, *((np.array([*o.center_m, 0.0]), o.radius_m, o.top_m) for o in obstacles)]
    # What an end lies inside of cannot be gone around: the target's keep-out, if one chose to.
    around = [c for c in around if clear(a, a, *c) and clear(b, b, *c)]

    def free(poses: list[Pose]) -> bool:
        points = [np.array(pose.position_m) for pose in poses]
        return all(clear(p, q, *c) for p, q in itertools.pairwise(points) for c in around)

    if free([start, *(leg.end for leg in legs)]):
        return legs
    choices = []
    for center, radius, height in around:
        for corner, _ in _corners(a, b, center, radius + MARGIN_M, height + MARGIN_M, end.heading_rad):
            middle = _pose(corner, end.heading_rad)
            if free([start, middle, end]):
                choices.append(_through(wind_m_s, limits, start, middle, end))
    if choices:
        return min(choices, key=_duration_s)
    top = max([a[2], b[2], *(height + MARGIN_M for _, _, height in around)])
    up, over = (_pose(np.array([*p[:2], top]), end.heading_rad) for p in (a, b))
    return _through(wind_m_s, limits, start, up, over, end)


def _through(wind_m_s: tuple[float, float], limits: FlightConfig, *poses: Pose) -> tuple[Leg, ...]:
    return tuple(fly_straight(p, q, limits, wind_m_s) for p, q in itertools.pairwise(poses))


def _duration_s(legs: tuple[Leg, ...]) -> float:
    return sum(leg.duration_s for leg in legs)


def _pose(position_m: Floats, heading_rad: float) -> Pose:
    x, y, z = (float(v) for v in position_m)
    return Pose((x, y, z), heading_rad)


def _corners(
    a: Floats, b: Floats, target: Floats, radius: float, height: float, end_heading: float
) -> list[tuple[Floats, float]]:
    """Corner positions and headings of the possible detours."""
    corners = []
    start_xy, end_xy = a[:2] - target[:2], b[:2] - target[:2]
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
            corner = np.array([*(target[:2] + xy), z])
            corners.append((corner, float(heading_to(corner, target))))

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
            corners.append((np.array([*(target[:2] + off), top]), end_heading))
        # From above the cylinder to beside it, be that within the margin: out over the rim first, and the reverse.
        elif enter <= 0 and (leave < length or end_d >= radius - MARGIN_M):
            rim = start_xy + min(leave, length) * unit
            corners.append((np.array([*(target[:2] + rim), height]), end_heading))
        elif leave >= length and (enter > 0 or start_d >= radius - MARGIN_M):
            rim = start_xy + max(enter, 0.0) * unit
            corners.append((np.array([*(target[:2] + rim), height]), end_heading))
    return corners
