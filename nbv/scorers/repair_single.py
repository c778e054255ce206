"""Eq. 8 in single precision, several times faster than `nbv.scorers.b_aware.repair`.

The sums are good to about 1e-6, which is enough to rank candidates unless two of them nearly tie:
`nbv.scorers.scorer` works out such candidates again in double precision, so that the ranking is that of
double precision. Everything is laid out so that each step is one pass over an array in the processor's cache.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nbv.types import Floats, Ints

Floats32 = NDArray[np.float32]

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


def longest_first(track_offsets: Ints) -> Ints:
    """(P,) the points by falling track length; of equals, the earlier first."""
    return np.argsort(-np.diff(track_offsets), kind="stable")


def observation_rays(
    points_m: Floats, track_offsets: Ints, track_cameras: Ints, camera_centers_m: Floats
) -> tuple[Floats32, Ints]:
    """Every point's first ray, then every point's second, ...; points must come longest track first.

    Returns (4, T): unit rays from the camera to the point, and their dot product with the point, and the
    start of each rank's rays, (longest track + 1,): the points that have a j-th ray are a prefix.
    """
    lengths = np.diff(track_offsets)
    longest = int(lengths[0]) if len(lengths) else 0
    counts = len(lengths) - np.searchsorted(lengths[::-1], np.arange(longest), side="right")
    first = track_offsets[:-1]
    empty = np.zeros(0, dtype=np.int64)
    camera = track_cameras[np.concatenate([empty, *(first[:k] + j for j, k in enumerate(counts))])]
    rays = np.empty((4, len(camera)), dtype=np.float32)
    points = points_m.T.astype(np.float32, order="C")
    centers = camera_centers_m.T.astype(np.float32, order="C")
    position = [np.concatenate([empty.astype(np.float32), *(x[:k] for k in counts)]) for x in points]
    for axis in range(3):
        np.subtract(position[axis], centers[axis].take(camera), out=rays[axis])
    rays[:3] /= np.sqrt(rays[0] * rays[0] + rays[1] * rays[1] + rays[2] * rays[2])
    rays[3] = rays[0] * position[0] + rays[1] * position[1] + rays[2] * position[2]
    return rays, np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)


def repair_single(
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
    """Eq. 8: (C,) share of all weakness that each candidate would repair, to about 1e-6.

    Arguments as for `nbv.scorers.b_aware.repair`, but the points must come longest track first.
    """
    origin = candidates_m.mean(axis=0)  # coordinates near 0 lose the fewest digits
    centers = camera_centers_m - origin
    points = points_m - origin
    candidates: Floats = (candidates_m - origin).astype(np.float32).astype(float)  # the same in every product
    n_candidates = len(candidates)
    low, high = np.deg2rad(theta_low_deg), np.deg2rad(theta_saturation_deg)
    cos_low, cos_high = np.float32(np.cos(low)), np.float32(np.cos(high))
    # The angles of the rounded cosines: what is clipped must gain 0 and 1 to the last digit, as most pairs do.
    low32, high32 = np.arccos(cos_low), np.arccos(cos_high)

    rays, starts = observation_rays(points, track_offsets, track_cameras, centers)
    n_rays = np.diff(starts)
    minus_c = np.concatenate([-candidates.T, np.ones((1, n_candidates))]).astype(np.float32)
    # |p - c|^2 = |p|^2 - 2 p . c + |c|^2, one product as well
    for_distance = np.concatenate([-2.0 * candidates.T, np.ones((1, n_candidates)),
                                   (candidates**2).sum(axis=1)[None]]).astype(np.float32)  # fmt: skip
    q = np.ones((len(points), 5), dtype=np.float32)
    q[:, :3] = points
    q[:, 3] = np.einsum("ij,ij->i", points, points)
    weak32 = weak.astype(np.float32)

    product, best = np.empty((2, BLOCK, n_candidates), dtype=np.float32)
    mass = np.zeros(n_candidates)
    for at in range(0, len(points), BLOCK):
        end = min(at + BLOCK, len(points))
        nearest = best[: end - at]  # becomes |p - c| cos(angle to the nearest ray)
        for rank, start in enumerate(starts[:-1].tolist()):
            k = min(end, int(n_rays[rank])) - at
            if k <= 0:
                break
            now = rays[:, start + at : start + at + k].T
            if rank == 0:
                np.matmul(now, minus_c, out=nearest[:k])
                nearest[k:] = -np.inf
            else:
                np.matmul(now, minus_c, out=product[:k])
                np.maximum(nearest[:k], product[:k], out=nearest[:k])
        if len(n_rays) == 0 or at >= n_rays[0]:
            nearest[:] = -np.inf
        distance = np.matmul(q[at:end], for_distance, out=product[: end - at])
        # A candidate on a point: no division by zero. (np.maximum with a number takes three times as long.)
        np.clip(distance, np.float32(1e-12), np.float32(np.inf), out=distance)
        np.sqrt(distance, out=distance)
        nearest /= distance
        np.clip(nearest, cos_high, cos_low, out=nearest)
        np.arccos(nearest, out=nearest)
        nearest -= low32
        nearest *= visible[at:end]
        mass += weak32[at:end] @ nearest
    return np.maximum(mass, 0.0) / float(high32 - low32) / max(float(weak.sum()), 1e-8)
