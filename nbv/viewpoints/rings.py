"""Rings of viewpoints on a sphere around the target, and the seed phase built from them."""

from __future__ import annotations

import math

from nbv.config import MissionConfig
from nbv.types import Viewpoint


def ring(
    target_m: tuple[float, float, float],
    radius_m: float,
    elevation_deg: float,
    count: int,
    band: str,
    id_prefix: str,
    first_index: int,
    id_digits: int,
) -> list[Viewpoint]:
    """``count`` viewpoints at one elevation, the first due north of the target, then clockwise.

    ``radius_m`` is the distance to the target, not the radius of the circle. Ids are
    ``{id_prefix}_{index}`` with ``id_digits`` digits, counting from ``first_index``.
    """
    elevation = math.radians(elevation_deg)
    horizontal_m = radius_m * math.cos(elevation)
    viewpoints = []
    for k in range(count):
        bearing_deg = 360.0 * k / count  # from north towards east
        bearing = math.radians(bearing_deg)
        position = (
            target_m[0] + horizontal_m * math.sin(bearing),
            target_m[1] + horizontal_m * math.cos(bearing),
            target_m[2] + radius_m * math.sin(elevation),
        )
        name = f"{id_prefix}_{first_index + k:0{id_digits}d}"
        viewpoints.append(Viewpoint(name, position, (90.0 - bearing_deg) % 360.0, elevation_deg, band))
    return viewpoints


def seed_viewpoints(config: MissionConfig) -> list[Viewpoint]:
    """The stratified seed orbit in the order flown: ring by ring, lowest first (``seed_00`` ...)."""
    seeds: list[Viewpoint] = []
    for elevation_deg, count in zip(config.seed.ring_elevations_deg, config.seed.ring_azimuth_counts):
        seeds += ring(
            config.target_m, config.seed.radius_m, elevation_deg, count, "seed", "seed", len(seeds), 2
        )
    return seeds
