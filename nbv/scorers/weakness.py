"""Eq. 6: how weak a sparse point is, from its track and its neighbourhood."""

from __future__ import annotations

import numpy as np

from nbv.config import BAwareConfig
from nbv.geometry.neighbours import neighbour_distances
from nbv.types import Floats, Ints


def percentile_scaled(values: Floats) -> Floats:
    """Values scaled so that their 5th and 95th percentiles are 0 and 1, clipped; all 0 if these coincide."""
    low, high = np.percentile(values, (5.0, 95.0))
    if high - low < 1e-8:
        return np.zeros_like(values)
    return np.clip((values - low) / (high - low), 0.0, 1.0)


def mean_neighbour_distance(points_m: Floats, neighbours: int) -> Floats:
    """(P,) mean distance to the nearest ``neighbours`` other points; zeros for a single point."""
    k = min(neighbours, len(points_m) - 1)
    if k < 1:
        return np.zeros(len(points_m))
    # Row by row a mean of a few numbers takes several times as long.
    return np.ascontiguousarray(neighbour_distances(points_m, k).T).mean(axis=0)


def weakness(
    points_m: Floats, track_lengths: Ints, reprojection_error_px: Floats, config: BAwareConfig
) -> Floats:
    """Eq. 6: (P,) weakness in [0, 1] of the tracked points in the box.

    Inverse track support and local sparsity; with ``alpha_reprojection`` (0 in the paper's text, 0.2
    in the authors' code) also the percentile-scaled reprojection error.

    Parameters
    ----------
    points_m
        (P, 3).
    track_lengths
        (P,) number of views of each point.
    reprojection_error_px
        (P,) mean of each point.
    config
        Weights of the three parts, and the track length that is long enough.
    """
    target = config.target_track_length
    w = config.alpha_track * np.clip((target - track_lengths) / target, 0.0, 1.0)
    if config.alpha_density > 0:
        spread = mean_neighbour_distance(points_m, config.density_neighbours)
        w = w + config.alpha_density * percentile_scaled(spread)
    if config.alpha_reprojection > 0 and np.any(reprojection_error_px > 0):
        w = w + config.alpha_reprojection * percentile_scaled(reprojection_error_px)
    return np.clip(w, 0.0, 1.0)
