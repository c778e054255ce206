"""Eq. 7 and 8 in double precision: how much of all weakness a candidate would repair."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from nbv.types import Floats, Ints

BLOCK = 128  # points at a time: a block's (BLOCK, C) arrays stay in the processor's cache
# Of few candidates several blocks at a time, or the calls take longer than the work.
BLOCK_PAIRS = BLOCK * 160


def _observations_by_block(
    order: Ints, lengths: Ints, track_offsets: Ints, track_cameras: Ints, block: int
) -> tuple[Ints, Ints, list[list[int]]]:
    """Observations sorted by (block of points, rank within the track), so that each group is a slice.

    ``order`` lists the points by falling track length. Returns each observation's point and camera, and
    for every block the sizes of its groups: how many of its points have a first ray, a second, ...
    """
    sizes = []
    firsts = []
    points = []
    for start in range(0, len(order), block):
        rows = order[start : start + block]
        n_rays = lengths[rows]
        longest = int(n_rays[0])
        # Points with more than j rays, for j = 0, 1, ...: a prefix, since the longest come first.
        counts = len(rows) - np.searchsorted(n_rays[::-1], np.arange(longest), side="right")
        sizes.append(counts.tolist())
        within = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
        points.append(rows[within])
        firsts.append(np.repeat(np.arange(longest), counts))
    point = np.concatenate(points) if points else np.zeros(0, dtype=np.int64)
    rank = np.concatenate(firsts) if firsts else np.zeros(0, dtype=np.int64)
    return point, track_cameras[track_offsets[point] + rank], sizes


def _gain_blocks(
    candidates_m: Floats,
    points_m: Floats,
    track_offsets: Ints,
    track_cameras: Ints,
    camera_centers_m: Floats,
    theta_low_deg: float,
    theta_saturation_deg: float,
) -> Iterator[tuple[Ints, Floats]]:
    """Eq. 7 block by block: the points' indices and their (B, C) gains, a buffer that is used again."""
    n_candidates = len(candidates_m)
    low, high = np.deg2rad(theta_low_deg), np.deg2rad(theta_saturation_deg)
    cos_low, cos_high = np.cos(low), np.cos(high)
    lengths = np.diff(track_offsets)
    size = BLOCK * max(1, BLOCK_PAIRS // (BLOCK * max(1, n_candidates)))

    # Longest tracks first: within a block, the points that have a j-th ray are then a prefix, and
    # (p - c) . ray = ray . p - ray . c for all candidates is one small matrix product.
    order = np.argsort(-lengths, kind="stable")
    point, camera, sizes = _observations_by_block(order, lengths, track_offsets, track_cameras, size)
    rays = np.empty((len(point), 4))  # unit ray, ray . p
    position = points_m.take(point, axis=0)
    for axis in range(3):  # several times faster than rows of three
        np.subtract(position[:, axis], camera_centers_m[:, axis].take(camera), out=rays[:, axis])
    length = np.sqrt(np.einsum("ij,ij->i", rays[:, :3], rays[:, :3]))
    for axis in range(3):
        rays[:, axis] /= length
    np.einsum("ij,ij->i", rays[:, :3], position, out=rays[:, 3])
    minus_c = np.concatenate([-candidates_m.T, np.ones((1, n_candidates))])  # (4, C)
    for_distance = np.concatenate(
        [-2.0 * candidates_m.T, np.ones((1, n_candidates)), (candidates_m**2).sum(axis=1)[None]]
    )

    product, best = np.empty((2, min(size, len(order)), n_candidates))
    at = 0
    for block, counts in enumerate(sizes):
        rows = order[block * size : (block + 1) * size]
        nearest = best[: len(rows)]  # becomes |p - c| cos(angle to the nearest ray)
        observed = counts[0] if counts else 0
        nearest[observed:] = -np.inf
        for j, k in enumerate(counts):
            if j == 0:
                np.matmul(rays[at : at + k], minus_c, out=nearest[:k])
            else:
                np.matmul(rays[at : at + k], minus_c, out=product[:k])
                np.maximum(nearest[:k], product[:k], out=nearest[:k])
            at += k
        p = np.ones((len(rows), 5))
        p[:, :3] = points_m[rows]
        np.einsum("ij,ij->i", p[:, :3], p[:, :3], out=p[:, 3])
        distance = np.matmul(p, for_distance, out=product[: len(rows)])
        np.maximum(distance, 1e-16, out=distance)  # a candidate on a point: no division by zero
        np.sqrt(distance, out=distance)
        nearest /= distance
        np.minimum(nearest, cos_low, out=nearest)
        np.maximum(nearest, cos_high, out=nearest)
        np.arccos(nearest, out=nearest)
        nearest -= low
        nearest *= 1.0 / (high - low)
        yield rows, nearest


def geometry_gain(
    candidates_m: Floats,
    points_m: Floats,
    track_offsets: Ints,
    track_cameras: Ints,
    camera_centers_m: Floats,
    theta_low_deg: float,
    theta_saturation_deg: float,
) -> Floats:
    """Eq. 7: (P, C) gain of each candidate's ray to each point, in [0, 1].

    0 up to ``theta_low_deg`` from the nearest existing observation ray, 1 from
    ``theta_saturation_deg`` on (or where a point has no observation). Tracks are CSR as in
    `nbv.types.SparseModel`, relative to ``points_m``.
    """
    gain = np.empty((len(points_m), len(candidates_m)))
    for rows, block in _gain_blocks(
        candidates_m,
        points_m,
        track_offsets,
        track_cameras,
        camera_centers_m,
        theta_low_deg,
        theta_saturation_deg,
    ):
        gain[rows] = block
    return np.clip(gain, 0.0, 1.0, out=gain)  # the clip of the cosine leaves the ends inexact by rounding


def repair(
    visible: NDArray[np.bool_],
    weak: Floats,
    candidates_m: Floats,
    points_m: Floats,
    track_offsets: Ints,
    track_cameras: Ints,
    camera_centers_m: Floats,
    theta_low_deg: float,
    theta_saturation_deg: float,
) -> Floats:
    """Eq. 8: (C,) share of all weakness that each candidate would repair.

    ``visible`` is (P, C), ``weak`` (P,). If no point is weak there is nothing to repair: zeros, through
    the reference's guard of 1e-8 on the denominator. The (P, C) gains are never stored.
    """
    mass = np.zeros(len(candidates_m))
    for rows, gain in _gain_blocks(
        candidates_m,
        points_m,
        track_offsets,
        track_cameras,
        camera_centers_m,
        theta_low_deg,
        theta_saturation_deg,
    ):
        gain *= visible[rows]
        for start in range(0, len(rows), BLOCK):  # summed in the same order, however many come at a time
            mass += weak[rows[start : start + BLOCK]] @ gain[start : start + BLOCK]
    return np.maximum(mass, 0.0) / max(float(weak.sum()), 1e-8)
