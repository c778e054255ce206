"""The two-band candidate pool of phase 2 (paper III), made anew at every iteration."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from nbv.config import MissionConfig
from nbv.geometry.frames import heading_to
from nbv.types import CandidatePool, Floats, Ints, Viewpoint
from nbv.viewpoints.rings import raw_candidates, ring_candidates, seed_viewpoints


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
        """
        return candidate_pool(config, vehicle_position_m, visited_m[n_seeds:])


RINGS = ViewpointSource()


def candidate_pool(
    config: MissionConfig, vehicle_position_m: Floats, adaptive_visited_m: Floats
) -> CandidatePool:
    """`ViewpointSource.candidates` from the rings; ``adaptive_visited_m`` (K, 3) are those of the photographs that are no seeds.

    Where *predicted* may choose, what the seeds' rings lack comes first, as high as the seeds and so never too low.

    ``counts`` of the pool are the survivors after each step: raw, altitude_travel, spacing, revisit, azimuth_balance.
    """
    pool, target = config.pool, np.array(config.target_m)
    raw = raw_candidates(config)
    if config.fills_rings:
        raw = (*ring_candidates(config), *raw)
    visited = np.asarray(adaptive_visited_m, dtype=float).reshape(-1, 3)
    positions = np.array([v.position_m for v in raw]).reshape(-1, 3)
    elevations = np.array([v.elevation_deg for v in raw])
    counts = {"raw": len(raw)}

    z, travel = positions[:, 2], np.linalg.norm(positions - vehicle_position_m, axis=1)
    of_ring = np.array([v.band == "ring" for v in raw], dtype=bool)
    allowed = (
        ((z >= pool.min_altitude_m) | of_ring) & (z <= pool.max_altitude_m) & (travel <= pool.max_travel_m)
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
