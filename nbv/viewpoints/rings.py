"""Rings of viewpoints on a sphere around the target, and the seed phase built from them."""

from __future__ import annotations

import math
from dataclasses import replace

from nbv.config import MissionConfig, SeedConfig
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
    first_bearing_deg: float = 0.0,
) -> list[Viewpoint]:
    """``count`` viewpoints at one elevation, clockwise from ``first_bearing_deg`` (0: due north of the target).

    Parameters
    ----------
    target_m
        What the ring stands about.
    radius_m
        Distance to the target, not the radius of the circle.
    elevation_deg, count
        Of the ring, and how many viewpoints it has.
    band
        Of the viewpoints.
    id_prefix, first_index, id_digits
        Ids are ``{id_prefix}_{index}`` with so many digits, counting from ``first_index``.
    first_bearing_deg
        Clockwise from north.
    """
    return [
        _viewpoint(
            target_m,
            radius_m,
            elevation_deg,
            first_bearing_deg + 360.0 * k / count,
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
    """The seeds in the order flown (``seed_00`` ...): the rings, or with ``seed.count`` one turn or two rings.

    One turn: even azimuths, clockwise from ``seed.start_bearing_deg``, elevations in turn: neighbours differ in both.
    Two rings (``seed.upper_share``): each with even azimuths from that bearing, the lower one first.
    """
    layout = config.seed
    if not layout.count:
        return ring_viewpoints(config.target_m, layout)
    if layout.upper_count:
        return ring_viewpoints(config.target_m, _two_rings(layout))
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


def second_turn_viewpoints(config: MissionConfig) -> list[Viewpoint]:
    """As many seeds again, named after the first: the same rings, each turned by half the step of its seeds."""
    layout, first = config.seed, config.seed.total
    if layout.count and not layout.upper_count:
        between = replace(layout, start_bearing_deg=layout.start_bearing_deg + 180.0 / layout.count)
    else:
        rings = _two_rings(layout) if layout.count else layout
        counts = rings.ring_azimuth_counts
        bearings_deg = rings.ring_bearings_deg or (0.0,) * len(counts)
        turned = tuple(start + 180.0 / count for start, count in zip(bearings_deg, counts))
        between = replace(rings, ring_bearings_deg=turned)
    views = seed_viewpoints(replace(config, seed=between))
    return [replace(view, id=f"seed_{first + k:02d}") for k, view in enumerate(views)]


def _two_rings(layout: SeedConfig) -> SeedConfig:
    return SeedConfig(
        ring_elevations_deg=(layout.lowest_deg, layout.upper_deg),
        ring_azimuth_counts=(layout.count - layout.upper_count, layout.upper_count),
        ring_bearings_deg=(layout.start_bearing_deg,) * 2,
        radius_m=layout.radius_m,
    )


def ring_viewpoints(target_m: tuple[float, float, float], layout: SeedConfig) -> list[Viewpoint]:
    """A stratified orbit: ring by ring, in the order of ``layout``'s rings (the paper's: lowest first)."""
    n = len(layout.ring_elevations_deg)
    radii_m = layout.ring_radii_m or (layout.radius_m,) * n
    bearings_deg = layout.ring_bearings_deg or (0.0,) * n
    seeds: list[Viewpoint] = []
    for elevation_deg, count, radius_m, bearing_deg in zip(
        layout.ring_elevations_deg, layout.ring_azimuth_counts, radii_m, bearings_deg
    ):
        seeds += ring(target_m, radius_m, elevation_deg, count, "seed", "seed", len(seeds), 2, bearing_deg)
    return seeds
