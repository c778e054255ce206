"""Baseline-aware repair (B-aware): weak points, seen from angles that are new to them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from nbv.config import BAwareConfig
from nbv.scorers.visibility import BLOCK
from nbv.types import Floats, Ints


def percentile_scaled(values: Floats) -> Floats:
    """Values scaled so that their 5th and 95th percentiles are 0 and 1, clipped; all 0 if these coincide."""
    low, high = np.percentile(values, [5.0, 95.0])
    if high - low < 1e-8:
        return np.zeros_like(values)
    return np.clip((values - low) / (high - low), 0.0, 1.0)


def mean_neighbour_distance(points_m: Floats, neighbours: int) -> Floats:
    """(P,) mean distance to the nearest ``neighbours`` other points; zeros for a single point."""
    k = min(neighbours, len(points_m) - 1)
    if k < 1:
        return np.zeros(len(points_m))
    tree = cKDTree(points_m, balanced_tree=False)
    distances, _ = tree.query(points_m, k=k + 1)  # the nearest is the point itself, at distance 0
    return distances[:, 1:].mean(axis=1)


def weakness(
    points_m: Floats, track_lengths: Ints, reprojection_error_px: Floats, config: BAwareConfig
) -> Floats:
    """Eq. 6: (P,) weakness in [0, 1] of the tracked points in the box.

    Inverse track support and local sparsity; with ``alpha_reprojection`` (0 in the paper's text, 0.2
    in the authors' code) also the percentile-scaled reprojection error.
    """
    target = config.target_track_length
    w = config.alpha_track * np.clip((target - track_lengths) / target, 0.0, 1.0)
    if config.alpha_density > 0:
        spread = mean_neighbour_distance(points_m, config.density_neighbours)
        w = w + config.alpha_density * percentile_scaled(spread)
    if config.alpha_reprojection > 0 and np.any(reprojection_error_px > 0):
        w = w + config.alpha_reprojection * percentile_scaled(reprojection_error_px)
    return np.clip(w, 0.0, 1.0)


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
    n_candidates = len(candidates_m)
    low, high = np.deg2rad(theta_low_deg), np.deg2rad(theta_saturation_deg)
    cos_low, cos_high = np.cos(low), np.cos(high)
    lengths = np.diff(track_offsets)
    gain = np.empty((len(points_m), n_candidates))

    # Longest tracks first: within a block, the points that have a j-th ray are then a prefix, and
    # (p - c) . ray = ray . p - ray . c for all candidates is one small matrix product.
    order = np.argsort(-lengths, kind="stable")
    minus_c = np.concatenate([-candidates_m.T, np.ones((1, n_candidates))])  # (4, C)
    squared = np.concatenate([-2.0 * candidates_m.T, np.ones((1, n_candidates)),
                              (candidates_m**2).sum(axis=1)[None]])  # fmt: skip
    product = np.empty((BLOCK, n_candidates))
    for start in range(0, len(points_m), BLOCK):
        rows = order[start : start + BLOCK]
        p, first, n_rays = points_m[rows], track_offsets[rows], lengths[rows]
        nearest = np.full((len(rows), n_candidates), -np.inf)  # |p - c| cos(angle to the nearest ray)
        for j in range(int(n_rays[0])):
            k = int(np.searchsorted(-n_rays, -j, side="left"))  # points with more than j rays
            ray = p[:k] - camera_centers_m[track_cameras[first[:k] + j]]
            ray /= np.sqrt(np.einsum("ij,ij->i", ray, ray))[:, None]
            along = np.einsum("ij,ij->i", ray, p[:k])[:, None]
            np.matmul(np.concatenate([ray, along], axis=1), minus_c, out=product[:k])
            np.maximum(nearest[:k], product[:k], out=nearest[:k])
        p_squared = np.einsum("ij,ij->i", p, p)[:, None]
        distance = np.concatenate([p, p_squared, np.ones((len(rows), 1))], axis=1) @ squared
        np.sqrt(np.maximum(distance, 1e-16, out=distance), out=distance)
        nearest /= distance
        np.clip(nearest, cos_high, cos_low, out=nearest)
        np.arccos(nearest, out=nearest)
        nearest -= low
        nearest /= high - low
        gain[rows] = nearest
    # The clip of the cosine rounds: keep the ends exact.
    return np.clip(gain, 0.0, 1.0, out=gain)


def repair(visible: NDArray[np.bool_], gain: Floats, weak: Floats) -> Floats:
    """Eq. 8: (C,) share of all weakness that each candidate would repair.

    ``visible`` and ``gain`` are (P, C), ``weak`` (P,). If no point is weak there is nothing to
    repair: zeros, through the reference's guard of 1e-8 on the denominator.
    """
    return (weak @ (gain * visible)) / max(float(weak.sum()), 1e-8)
