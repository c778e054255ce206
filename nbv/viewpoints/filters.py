"""Feasibility filters of the candidate pool. Each takes indices into the raw pool and returns the
survivors' indices, in the order that the next filter (and, in the end, tie-breaking) sees."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from nbv.types import Floats, Ints


def within_altitude_and_travel(
    positions_m: Floats,
    keep: Ints,
    min_altitude_m: float,
    max_altitude_m: float,
    vehicle_position_m: Floats,
    max_travel_m: float,
) -> Ints:
    """Altitude limits (inclusive) and straight-line distance from where the vehicle really is.

    Parameters
    ----------
    positions_m, keep
        (R, 3) the raw pool, and (K,) the rows that are left of it.
    min_altitude_m, max_altitude_m
        Above z = 0.
    vehicle_position_m, max_travel_m
        (3,), and how far from there a candidate may lie.
    """
    z = positions_m[keep, 2]
    travel = np.linalg.norm(positions_m[keep] - vehicle_position_m, axis=1)
    return keep[(z >= min_altitude_m) & (z <= max_altitude_m) & (travel <= max_travel_m)]


def spaced(positions_m: Floats, keep: Ints, min_spacing_m: float) -> Ints:
    """First come, first kept: drop a candidate closer than ``min_spacing_m`` to one already kept.

    The paper calls it angular spacing; the authors' code measures Euclidean distance, and so does this.
    """
    return keep[_spaced(np.ascontiguousarray(positions_m[keep], dtype=np.float64).tobytes(), min_spacing_m)]


@lru_cache(maxsize=8)  # nearly always the same question: the pool hardly changes before this filter
def _spaced(points: bytes, min_spacing_m: float) -> Ints:
    points_m = np.frombuffer(points).reshape(-1, 3)
    close = np.linalg.norm(points_m[:, None] - points_m[None], axis=2) < min_spacing_m
    kept: list[int] = []
    for i in range(len(points_m)):
        if not close[i, kept].any():
            kept.append(i)
    return np.array(kept, dtype=np.int64)


def not_revisiting(positions_m: Floats, keep: Ints, adaptive_visited_m: Floats, exclusion_m: float) -> Ints:
    """Drop candidates closer than ``exclusion_m`` to the commanded position of an adaptive capture.

    Parameters
    ----------
    positions_m, keep
        (R, 3) the raw pool, and (K,) the rows that are left of it.
    adaptive_visited_m
        (V, 3) commanded positions of the adaptive captures.
    exclusion_m
        Least distance to all of them.
    """
    if len(adaptive_visited_m) == 0:
        return keep
    distance = np.linalg.norm(positions_m[keep][:, None] - adaptive_visited_m[None], axis=2)
    return keep[distance.min(axis=1) >= exclusion_m]


def sector_of(positions_m: Floats, target_m: Floats, sectors: int) -> Ints:
    """(K,) azimuth sector of each position; sector 0 starts due north, counting clockwise."""
    delta = np.asarray(positions_m, dtype=float).reshape(-1, 3) - target_m
    bearing = np.arctan2(delta[:, 0], delta[:, 1]) / (2 * np.pi) * sectors
    # Many viewpoints lie exactly on a sector's edge: rounding must not decide where they belong.
    return np.floor(bearing + 1e-9).astype(np.int64) % sectors


def azimuth_balanced(
    positions_m: Floats,
    elevations_deg: Floats,
    keep: Ints,
    target_m: Floats,
    adaptive_visited_m: Floats,
    sectors: int,
    max_candidates: int,
) -> Ints:
    """Stable sort: sectors with the fewest adaptive captures first, then the highest elevation first;
    then at most ``max_candidates``. Below that count only tie-breaking feels it.

    Parameters
    ----------
    positions_m, elevations_deg, keep
        (R, 3) and (R,) the raw pool, and (K,) the rows that are left of it.
    target_m
        (3,) about which sectors are counted.
    adaptive_visited_m
        (V, 3) commanded positions of the adaptive captures.
    sectors, max_candidates
        How many there are, and how many candidates are left at most.
    """
    counts = np.bincount(sector_of(adaptive_visited_m, target_m, sectors), minlength=sectors)
    visited = counts[sector_of(positions_m[keep], target_m, sectors)]
    return keep[np.lexsort((-elevations_deg[keep], visited))][:max_candidates]
