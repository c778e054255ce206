"""Eq. 8 in single precision, several times faster than `nbv.scorers.repair.repair`.

The sums are good to about 1e-6, which is enough to rank candidates unless two of them nearly tie:
`nbv.scorers.b_aware` works out such candidates again in double precision, so that the ranking is that of
double precision. Everything is laid out so that each step is one pass over an array in the processor's cache.
"""

from __future__ import annotations

import numpy as np

from nbv.geometry.scratch import scratch
from nbv.scorers.box import BoxPoints
from nbv.types import Bools, Floats, Floats32, Ints

BLOCK = 512  # points at a time: two (BLOCK, C) arrays stay in the second-level cache
MIN_ANGLE_DEG = 1.5
MAX_ERROR = 6e-6


def precision(theta_low_deg: float, theta_saturation_deg: float) -> float:
    """Error of `repair_single` that is allowed for: twice or more what states show; not a worst case.

    The sum over the points, most of which gain nothing or everything alike, is off by up to 5e-7. An
    error in the cosine is one of that / sin(angle) in the angle, and angles below ``theta_low_deg`` are
    clipped; of many points these cancel. Infinite (do not use it) where small angles count, since an arc
    cosine is useless there, or where it exceeds ``MAX_ERROR``.
    """
    low, high = np.deg2rad(theta_low_deg), np.deg2rad(theta_saturation_deg)
    error = 1e-6 + float(3e-8 / ((high - low) * np.sin(low))) if theta_low_deg >= MIN_ANGLE_DEG else np.inf
    return error if error <= MAX_ERROR else np.inf


def observation_rays(
    points_m: Floats, track_starts: Ints, track_lengths: Ints, track_cameras: Ints, camera_centers_m: Floats
) -> tuple[Floats32, list[int]]:
    """Every point's first ray, then every point's second, ...

    Parameters
    ----------
    points_m
        (3, P), longest track first.
    track_starts, track_lengths
        (P,) where each point's track begins in ``track_cameras``, and how long it is.
    track_cameras
        (T,) cameras of the tracks, one track after the other.
    camera_centers_m
        (3, M).

    Returns
    -------
    rays, counts
        (4, T): unit rays from the camera to the point, and their dot product with the point. How many points have a
        first ray, a second, ... (as many numbers as the longest track is long): those that have a j-th ray are a prefix.
    """
    longest = int(track_lengths[0]) if len(track_lengths) else 0
    counts = len(track_lengths) - np.searchsorted(track_lengths[::-1], np.arange(longest), side="right")
    if longest == 0:
        return np.zeros((4, 0), dtype=np.float32), []
    camera = track_cameras.take(np.concatenate([track_starts[:k] + j for j, k in enumerate(counts)]))
    rays = np.empty((4, len(camera)), dtype=np.float32)
    centers = camera_centers_m.astype(np.float32)
    position = [np.concatenate([x[:k] for k in counts]) for x in points_m.astype(np.float32)]
    for axis in range(3):
        centers[axis].take(camera, out=rays[axis], mode="clip")  # the mode that writes to ``out`` directly
        np.subtract(position[axis], rays[axis], out=rays[axis])
    length, product = rays[3], np.empty_like(rays[3])
    _dot(rays, rays, length, product)
    rays[:3] /= np.sqrt(length, out=length)
    _dot(rays, position, rays[3], product)
    return rays, counts.tolist()


def _dot(a: Floats32, b: Floats32 | list[Floats32], out: Floats32, product: Floats32) -> None:
    """``a[0] * b[0] + a[1] * b[1] + a[2] * b[2]`` without new arrays."""
    np.multiply(a[0], b[0], out=out)
    for axis in (1, 2):
        np.add(out, np.multiply(a[axis], b[axis], out=product), out=out)


def repair_single(
    visible: Bools,
    weak: Floats,
    candidates_m: Floats,
    box: BoxPoints,
    order: Ints,
    theta_low_deg: float,
    theta_saturation_deg: float,
) -> Floats:
    """Eq. 8: (C,) share of all weakness that each candidate would repair, to about 1e-6.

    Parameters
    ----------
    visible, weak
        As for `nbv.scorers.repair.repair`, but with rows in that ``order``.
    candidates_m, box, theta_low_deg, theta_saturation_deg
        As there.
    order
        (P,) the points of ``box``, longest track first.
    """
    points_m = box.points_m[order]
    starts_of_tracks, lengths = box.track_offsets[order], box.track_lengths[order]
    origin = candidates_m.mean(axis=0)  # coordinates near 0 lose the fewest digits
    centers = (box.camera_centers_m - origin).T
    points = np.subtract(points_m.T, origin[:, None], order="C")  # (3, P)
    candidates: Floats = (candidates_m - origin).astype(np.float32).astype(float)  # the same in every product
    n_points, n_candidates = len(points_m), len(candidates)
    low, high = np.deg2rad(theta_low_deg), np.deg2rad(theta_saturation_deg)
    cos_low, cos_high = np.float32(np.cos(low)), np.float32(np.cos(high))
    # The angles of the rounded cosines: what is clipped must gain 0 and 1 to the last digit, as most pairs do.
    low32, high32 = np.arccos(cos_low), np.arccos(cos_high)

    rays, n_rays = observation_rays(points, starts_of_tracks, lengths, box.track_cameras, centers)
    starts = [0, *np.cumsum(n_rays).tolist()]
    minus_c = np.concatenate([-candidates.T, np.ones((1, n_candidates))]).astype(np.float32)
    # |p - c|^2 = |p|^2 - 2 p . c + |c|^2, one product as well
    for_distance = np.concatenate(
        [-2.0 * candidates.T, np.ones((1, n_candidates)), (candidates**2).sum(axis=1)[None]]
    ).astype(np.float32)
    q = np.ones((5, n_points), dtype=np.float32)
    q[:3] = points
    q[3] = np.einsum("ij,ij->j", points, points)
    weak32 = weak.astype(np.float32)
    # Within rounding of a point a candidate must be kept from a division by zero; nearly always all are far.
    apart = separation(points, candidates.T) > 0.1

    product, best = scratch(2, BLOCK, n_candidates)
    mass = np.zeros(n_candidates)
    for at in range(0, n_points, BLOCK):
        end = min(at + BLOCK, n_points)
        nearest = best[: end - at]  # becomes |p - c| cos(angle to the nearest ray)
        observed = 0
        for start, n in zip(starts, n_rays):
            k = min(end, n) - at
            if k <= 0:
                break
            now = rays[:, start + at : start + at + k].T
            if observed == 0:
                observed = k
                np.matmul(now, minus_c, out=nearest[:k])
            else:
                np.matmul(now, minus_c, out=product[:k])
                np.maximum(nearest[:k], product[:k], out=nearest[:k])
        nearest[observed:] = -np.inf
        distance = np.matmul(q[:, at:end].T, for_distance, out=product[: end - at])
        if not apart:
            np.clip(distance, np.float32(1e-12), np.float32(np.inf), out=distance)
        np.sqrt(distance, out=distance)
        nearest /= distance
        np.clip(nearest, cos_high, cos_low, out=nearest)
        np.arccos(nearest, out=nearest)
        nearest -= low32
        nearest *= visible[at:end]
        mass += weak32[at:end] @ nearest
    return np.maximum(mass, 0.0) / float(high32 - low32) / max(float(weak.sum()), 1e-8)


def separation(points_m: Floats, candidates_m: Floats) -> float:
    """Smallest distance (m) of the candidates (3, C) from the points' (3, P) bounding box, at most that to a point."""
    low, high = points_m.min(axis=1)[:, None], points_m.max(axis=1)[:, None]
    outside = np.maximum(np.maximum(low - candidates_m, candidates_m - high), 0.0)
    return float(np.sqrt((outside**2).sum(axis=0).min()))
