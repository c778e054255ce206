"""Where the camera may go: the seed rings (phase 1) and the two-band candidate pool (phase 2).

As in the authors' public code, a ring's azimuths are 360 k / n for k = 0 .. n - 1, measured from **north towards east**, so that
every ring has a viewpoint due north of the target; `Viewpoint.azimuth_deg` is the same direction in this project's convention,
counter-clockwise from east. A ring of 6 therefore is not the ring that one would get by counting from east.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from nbv.config import MissionConfig, PoolConfig
from nbv.geometry.frames import heading_to
from nbv.types import CandidatePool, Floats, Ints, Point, Viewpoint

# Rings of viewpoints on a sphere around the target: the seeds of phase 1, and the raw candidates of phase 2.


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


# The two-band candidate pool of phase 2 (paper III), made anew at every iteration.


class ViewpointSource:
    """Where a mission may take its photographs: here the paper's rings, anywhere about the target."""

    # Whether viewpoints move with the target when it is found elsewhere than assumed; if not it is not looked for.
    follows_target = True

    def seeds(self, config: MissionConfig) -> Sequence[Viewpoint]:
        """The seeds of Phase 1 in the order flown."""
        return seed_viewpoints(config)

    def candidates(
        self, config: MissionConfig, vehicle_position_m: Floats, visited_m: Floats, n_seeds: int
    ) -> CandidatePool:
        """The feasible candidates of one iteration, in the order in which ties are broken; may be empty.

        ``vehicle_position_m`` (3,) is where the vehicle estimates to be, ``visited_m`` (V, 3) the commanded positions of all photographs so far, of which
        the first ``n_seeds`` are seeds.

        Where *predicted* may choose, what the seeds' rings lack comes first, as high as the seeds and so never too low.

        ``counts`` of the pool are the survivors after each step: raw, altitude_travel, spacing, revisit, azimuth_balance.
        """
        pool, target = config.pool, np.array(config.target_m)
        raw = raw_candidates(config)
        if config.fills_rings:
            raw = (*ring_candidates(config), *raw)
        visited = np.asarray(visited_m[n_seeds:], dtype=float).reshape(-1, 3)
        positions = np.array([v.position_m for v in raw]).reshape(-1, 3)
        elevations = np.array([v.elevation_deg for v in raw])
        counts = {"raw": len(raw)}

        z, travel = positions[:, 2], np.linalg.norm(positions - vehicle_position_m, axis=1)
        of_ring = np.array([v.band == "ring" for v in raw], dtype=bool)
        allowed = (
            ((z >= pool.min_altitude_m) | of_ring)
            & (z <= pool.max_altitude_m)
            & (travel <= pool.max_travel_m)
        )
        keep = np.flatnonzero(allowed & (elevations <= pool.max_elevation_deg))
        counts["altitude_travel"] = len(keep)
        # The paper calls it angular spacing; the authors' code measures Euclidean distance, and so does this.
        keep = keep[_spaced(positions[keep].tobytes(), pool.min_spacing_m)]
        counts["spacing"] = len(keep)
        if len(visited):
            distance = np.linalg.norm(positions[keep][:, None] - visited[None], axis=2)
            keep = keep[distance.min(axis=1) >= pool.revisit_exclusion_m]
        counts["revisit"] = len(keep)
        # Sectors with the fewest adaptive captures first, then the highest elevation first; below `max_candidates` only
        # tie-breaking feels it.
        sectors = pool.azimuth_sectors
        captures = np.bincount(sector_of(visited, target, sectors), minlength=sectors)
        captures_there = captures[sector_of(positions[keep], target, sectors)]
        keep = keep[np.lexsort((-elevations[keep], captures_there, ~of_ring[keep]))][: pool.max_candidates]
        counts["azimuth_balance"] = len(keep)

        chosen = [raw[i] for i in keep.tolist()]
        return CandidatePool(
            ids=tuple(v.id for v in chosen),
            positions_m=positions[keep],
            headings_rad=heading_to(positions[keep], target),
            azimuths_deg=np.array([v.azimuth_deg for v in chosen]),
            elevations_deg=elevations[keep],
            bands=tuple(v.band for v in chosen),
            counts=counts,
        )


RINGS = ViewpointSource()


@lru_cache(maxsize=8)  # nearly always the same question: the pool hardly changes before this filter
def _spaced(positions: bytes, min_spacing_m: float) -> Ints:
    """First come, first kept: rows of the positions (K, 3), less those nearer than ``min_spacing_m`` to one already kept."""
    points_m = np.frombuffer(positions).reshape(-1, 3)
    close = np.linalg.norm(points_m[:, None] - points_m[None], axis=2) < min_spacing_m
    kept: list[int] = []
    for i in range(len(points_m)):
        if not close[i, kept].any():
            kept.append(i)
    return np.array(kept, dtype=np.int64)


def sector_of(positions_m: Floats, target_m: Floats, sectors: int) -> Ints:
    """(K,) azimuth sector of each position; sector 0 starts due north, counting clockwise."""
    delta = np.asarray(positions_m, dtype=float).reshape(-1, 3) - target_m
    bearing = np.arctan2(delta[:, 0], delta[:, 1]) / (2 * np.pi) * sectors
    # Many viewpoints lie exactly on a sector's edge: rounding must not decide where they belong.
    return np.floor(bearing + 1e-9).astype(np.int64) % sectors
