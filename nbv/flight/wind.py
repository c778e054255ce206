"""Wind on the flight: a steady horizontal wind of one direction, and gusts that push the hovering vehicle about.

What gusts blur in a photograph is `nbv.config.SensorConfig`'s ``residual_speed_m_s``.
"""

from __future__ import annotations

import math

from nbv.config import FlightConfig, WindConfig
from nbv.random_streams import keyed_rng
from nbv.types import Floats

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
