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
    return [
        _viewpoint(
            target_m,
            radius_m,
            elevation_deg,
            360.0 * k / count,
            band,
            f"{id_prefix}_{first_index + k:0{id_digits}d}",
        )
        for k in range(count)
    ]


def _viewpoint(
    target_m: tuple[float, float, float],
    radius_m: float,
    elevation_deg: float,
    bearing_deg: float,
    band: str,
    name: str,
) -> Viewpoint:
    """``bearing_deg`` runs from north towards east."""
    elevation, bearing = math.radians(elevation_deg), math.radians(bearing_deg)
    horizontal_m = radius_m * math.cos(elevation)
    position = (
        target_m[0] + horizontal_m * math.sin(bearing),
        target_m[1] + horizontal_m * math.cos(bearing),
        target_m[2] + radius_m * math.sin(elevation),
    )
    return Viewpoint(name, position, (90.0 - bearing_deg) % 360.0, elevation_deg, band)


def seed_viewpoints(config: MissionConfig) -> list[Viewpoint]:
    """The seeds in the order flown (``seed_00`` ...): the paper's rings, or with ``seed.count`` one turn.

    One turn: even azimuths, clockwise from ``seed.start_bearing_deg``, elevations in turn: neighbours differ in both.
    """
    layout = config.seed
    if not layout.count:
        return ring_viewpoints(config)
    step_deg = 360.0 / layout.count
    return [
        _viewpoint(
            config.target_m,
            layout.radius_m,
            layout.layout_deg[k % layout.rings],
            layout.start_bearing_deg + k * step_deg,
            "seed",
            f"seed_{k:02d}",
        )
        for k in range(layout.count)
    ]


def ring_viewpoints(config: MissionConfig) -> list[Viewpoint]:
    """The paper's stratified orbit: ring by ring, lowest first."""
    seeds: list[Viewpoint] = []
    for elevation_deg, count in zip(config.seed.ring_elevations_deg, config.seed.ring_azimuth_counts):
        seeds += ring(
            config.target_m, config.seed.radius_m, elevation_deg, count, "seed", "seed", len(seeds), 2
        )
    return seeds
