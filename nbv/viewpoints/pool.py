"""The two-band candidate pool of phase 2 (paper III), made anew at every iteration."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from nbv.config import MissionConfig, PoolConfig, SeedConfig
from nbv.geometry.frames import heading_to
from nbv.types import CandidatePool, Floats, Viewpoint
from nbv.viewpoints import filters
from nbv.viewpoints.rings import ring, ring_viewpoints


def lateral_ring_counts(total: int, rings: int) -> list[int]:
    """``total`` candidates shared out by inverse rank (1, 1/2, 1/3, ...), at least one per ring.

    Rounding drift is taken from (or given to) the last ring. 120 over 4 rings: 58, 29, 19, 14.
    """
    if rings == 0:
        return []
    weights = [1.0 / (rank + 1) for rank in range(rings)]
    counts = [max(1, round(total * w / sum(weights))) for w in weights]
    counts[-1] = max(1, counts[-1] + total - sum(counts))
    return counts


def upper_ring_counts(total: int, rings: int) -> list[int]:
    """``total`` shared out equally; the remainder goes to the first rings. 50 over 3: 17, 17, 16."""
    if rings == 0:
        return []
    return [total // rings + (1 if i < total % rings else 0) for i in range(rings)]


@lru_cache(maxsize=8)
def _raw_candidates(pool: PoolConfig, target_m: tuple[float, float, float]) -> tuple[Viewpoint, ...]:
    bands = (
        (
            "lateral",
            pool.lateral_elevations_deg,
            lateral_ring_counts(pool.lateral_count, len(pool.lateral_elevations_deg)),
        ),
        (
            "upper",
            pool.upper_elevations_deg,
            upper_ring_counts(pool.upper_count, len(pool.upper_elevations_deg)),
        ),
    )
    candidates: list[Viewpoint] = []
    for band, elevations, counts in bands:
        for elevation_deg, count in zip(elevations, counts):
            candidates += ring(
                target_m, pool.radius_m, elevation_deg, count, band, "cand", len(candidates), 3
            )
    return tuple(candidates)


@lru_cache(maxsize=8)
def _raw_arrays(pool: PoolConfig, target_m: tuple[float, float, float]) -> tuple[Floats, Floats, Floats]:
    """Positions (R, 3), azimuths and elevations (R,) of the raw candidates; read-only."""
    raw = _raw_candidates(pool, target_m)
    arrays = (
        np.array([v.position_m for v in raw]).reshape(-1, 3),
        np.array([v.azimuth_deg for v in raw]),
        np.array([v.elevation_deg for v in raw]),
    )
    for array in arrays:
        array.setflags(write=False)
    return arrays


def raw_candidates(config: MissionConfig) -> tuple[Viewpoint, ...]:
    """All candidates before any filter, lateral band first; the same in every iteration and mission."""
    return _raw_candidates(config.pool, config.target_m)


def shell_viewpoints(config: MissionConfig) -> list[Viewpoint]:
    """The paper's seed rings and the unfiltered candidates: where a mission may photograph from.

    The same for every layout of the seeds, so that all are measured against one observable surface.
    """
    return [*ring_viewpoints(config.target_m, SeedConfig()), *raw_candidates(config)]


def candidate_pool(
    config: MissionConfig, vehicle_position_m: Floats, adaptive_visited_m: Floats
) -> CandidatePool:
    """The feasible candidates of one iteration, in the order in which ties are broken.

    Parameters
    ----------
    vehicle_position_m
        (3,) where the vehicle really is.
    adaptive_visited_m
        (K, 3) commanded positions of the adaptive captures so far, without the seeds; K may be 0.

    Returns
    -------
    CandidatePool
        Possibly empty: whether the mission ends there is the mission's decision. ``counts`` holds the
        survivors after each step: raw, altitude_travel, spacing, revisit, azimuth_balance.
    """
    pool = config.pool
    raw = raw_candidates(config)
    target = np.array(config.target_m)
    visited = np.asarray(adaptive_visited_m, dtype=float).reshape(-1, 3)
    positions, azimuths, elevations = _raw_arrays(pool, config.target_m)

    keep = np.arange(len(raw), dtype=np.int64)
    counts = {"raw": len(keep)}
    keep = filters.within_altitude_and_travel(
        positions,
        keep,
        pool.min_altitude_m,
        pool.max_altitude_m,
        np.asarray(vehicle_position_m, dtype=float),
        pool.max_travel_m,
    )
    counts["altitude_travel"] = len(keep)
    keep = filters.spaced(positions, keep, pool.min_spacing_m)
    counts["spacing"] = len(keep)
    keep = filters.not_revisiting(positions, keep, visited, pool.revisit_exclusion_m)
    counts["revisit"] = len(keep)
    keep = filters.azimuth_balanced(
        positions, elevations, keep, target, visited, pool.azimuth_sectors, pool.max_candidates
    )
    counts["azimuth_balance"] = len(keep)

    chosen = keep.tolist()
    return CandidatePool(
        ids=tuple([raw[i].id for i in chosen]),
        positions_m=positions[keep],
        headings_rad=heading_to(positions[keep], target),
        azimuths_deg=azimuths[keep],
        elevations_deg=elevations[keep],
        bands=tuple([raw[i].band for i in chosen]),
        counts=counts,
    )
