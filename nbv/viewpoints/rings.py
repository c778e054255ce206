"""Rings of viewpoints on a sphere around the target: the seeds of phase 1, and the raw candidates of phase 2."""

from __future__ import annotations

import itertools
import math
from functools import lru_cache

import numpy as np

from nbv.config import MissionConfig, PoolConfig
from nbv.types import Floats, Point, Viewpoint

RING_STEP_DEG = 7.5
# Distance to the target (m), elevation, and bearing clockwise from north (degrees).
RingPosition = tuple[float, float, float]


def _ring(radius_m: float, elevation_deg: float, count: int) -> list[RingPosition]:
    return [(radius_m, elevation_deg, 360.0 * k / count) for k in range(count)]


def _viewpoint(target_m: Point, at: RingPosition, band: str, name: str) -> Viewpoint:
    radius_m, elevation_deg, bearing_deg = at
    elevation, bearing = math.radians(elevation_deg), math.radians(bearing_deg)
    horizontal_m = radius_m * math.cos(elevation)
    position = (
        target_m[0] + horizontal_m * math.sin(bearing),
        target_m[1] + horizontal_m * math.cos(bearing),
        target_m[2] + radius_m * math.sin(elevation),
    )
    return Viewpoint(name, position, (90.0 - bearing_deg) % 360.0, elevation_deg, band)


def seed_viewpoints(config: MissionConfig) -> list[Viewpoint]:
    """The seeds in the order flown (``seed_00`` ...): on the paper's rings, or in a turn of one ring or two.

    Each ring has even azimuths, clockwise from north; of two (``seed.upper_share``) that at ``seed.lowest_deg`` is first.
    """
    positions = _seed_positions(config)
    return [_viewpoint(config.target_m, at, "seed", f"seed_{k:02d}") for k, at in enumerate(positions)]


def _seed_positions(config: MissionConfig) -> list[RingPosition]:
    seed, rings = config.seed, config.seed_rings
    if seed.layout == "turn" and len(rings) == 1:
        step_deg = 360.0 / config.seeds
        return [(seed.radius_m, seed.lowest_deg, k * step_deg) for k in range(config.seeds)]
    return [at for elevation_deg, n in rings for at in _ring(seed.radius_m, elevation_deg, n)]


def ring_candidates(config: MissionConfig) -> list[Viewpoint]:
    """What the seeds' rings lack (``ring_000`` ...): views between the seeds, at most `RING_STEP_DEG` apart."""
    between: list[RingPosition] = []
    rings = itertools.groupby(_seed_positions(config), key=lambda at: at[:2])
    for (radius_m, elevation_deg), seeds in rings:
        count = len(list(seeds))
        finer = math.ceil(360.0 / count / RING_STEP_DEG)
        filled = _ring(radius_m, elevation_deg, finer * count)
        between += [at for k, at in enumerate(filled) if k % finer]
    return [_viewpoint(config.target_m, at, "ring", f"ring_{k:03d}") for k, at in enumerate(between)]


def lateral_ring_counts(total: int, rings: int) -> list[int]:
    """``total`` candidates shared out by inverse rank (1, 1/2, 1/3, ...), at least one per ring, on the first ``total`` rings if these are fewer.

    Rounding drift is taken from (or given to) the last ring, what it has not from the largest. 120 over 4 rings: 58, 29, 19, 14.
    """
    rings = min(rings, total)
    if rings == 0:
        return []
    weights = [1.0 / (rank + 1) for rank in range(rings)]
    counts = [max(1, round(total * w / sum(weights))) for w in weights]
    counts[-1] = max(1, counts[-1] + total - sum(counts))
    while sum(counts) > total:
        counts[counts.index(max(counts))] -= 1
    return counts


@lru_cache(maxsize=8)
def _raw_candidates(pool: PoolConfig, target_m: Point) -> tuple[Viewpoint, ...]:
    lateral, upper = pool.lateral_elevations_deg, pool.upper_elevations_deg
    bands = (
        ("lateral", lateral, lateral_ring_counts(pool.lateral_count, len(lateral))),
        # Equally; the remainder goes to the first rings.
        ("upper", upper, [len(range(i, pool.upper_count, len(upper))) for i in range(len(upper))]),
    )
    ring_positions = [
        (band, at)
        for band, elevations_deg, counts in bands
        for elevation_deg, count in zip(elevations_deg, counts)
        for at in _ring(pool.radius_m, elevation_deg, count)
    ]
    return tuple(
        _viewpoint(target_m, at, band, f"cand_{k:03d}") for k, (band, at) in enumerate(ring_positions)
    )


def raw_candidates(config: MissionConfig) -> tuple[Viewpoint, ...]:
    """All candidates before any filter, lateral band first; the same in every iteration and mission."""
    return _raw_candidates(config.pool, config.target_m)


def camera_shell(config: MissionConfig) -> Floats:
    """(C, 3) the paper's seed rings and unfiltered candidates about the target: where a mission may photograph from.

    The same for every layout of seeds and pool, so that all are measured against one observable surface.
    """
    seeds = seed_viewpoints(MissionConfig(target_m=config.target_m))
    return np.array([v.position_m for v in (*seeds, *_raw_candidates(PoolConfig(), config.target_m))])
