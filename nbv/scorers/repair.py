"""Eq. 7 and 8 in double precision: how much of all weakness a candidate would repair."""

from __future__ import annotations

import numpy as np

from nbv.scorers.box import BoxPoints
from nbv.types import Bools, Floats

BLOCK = 128  # points whose weakness is summed at a time


def geometry_gain(
    candidates_m: Floats, box: BoxPoints, theta_low_deg: float, theta_saturation_deg: float
) -> Floats:
    """Eq. 7: (P, C) gain of each candidate's ray to each of the P points, in [0, 1].

    Parameters
    ----------
    candidates_m
        (C, 3) positions.
    box
        The points with their tracks.
    theta_low_deg
        Up to this angle from the nearest existing observation ray the gain is 0.
    theta_saturation_deg
        From this angle on it is 1, and where a point has no observation.
    """
    low, high = np.deg2rad(theta_low_deg), np.deg2rad(theta_saturation_deg)
    points_m, lengths = box.points_m, box.track_lengths
    position = points_m.repeat(lengths, axis=0)
    ray = position - box.camera_centers_m[box.track_cameras]
    ray /= np.sqrt(np.einsum("ij,ij->i", ray, ray))[:, None]
    along = np.column_stack([ray, np.einsum("ij,ij->i", ray, position)])  # unit ray, ray . p
    one = np.ones((1, len(candidates_m)))
    # |p - c| cos(angle to the nearest ray): (p - c) . ray = ray . p - ray . c, the largest of each point's rays
    nearest = np.full((len(points_m), len(candidates_m)), -np.inf)
    observed = np.flatnonzero(lengths)
    if len(observed):
        product = along @ np.concatenate([-candidates_m.T, one])
        nearest[observed] = np.maximum.reduceat(product, box.track_offsets[observed], axis=0)
    q = np.column_stack([points_m, np.ones(len(points_m)), np.einsum("ij,ij->i", points_m, points_m)])
    squared = q @ np.concatenate([-2.0 * candidates_m.T, (candidates_m**2).sum(axis=1)[None], one])
    # A candidate may be on a point: no division by zero.
    cosine = np.clip(nearest / np.sqrt(np.maximum(squared, 1e-16)), np.cos(high), np.cos(low))
    return np.clip((np.arccos(cosine) - low) / (high - low), 0.0, 1.0)


def repair(
    visible: Bools,
    weak: Floats,
    candidates_m: Floats,
    box: BoxPoints,
    theta_low_deg: float,
    theta_saturation_deg: float,
) -> Floats:
    """Eq. 8: (C,) share of all weakness that each candidate would repair.

    If no point is weak there is nothing to repair: zeros, through the reference's guard of 1e-8 on the denominator.

    Parameters
    ----------
    visible
        (P, C) which points each candidate sees.
    weak
        (P,) weakness of the points (Eq. 6).
    candidates_m, box, theta_low_deg, theta_saturation_deg
        As in `geometry_gain`.
    """
    gain = visible * geometry_gain(candidates_m, box, theta_low_deg, theta_saturation_deg)
    mass = np.zeros(len(candidates_m))
    for start in range(0, len(weak), BLOCK):
        mass += weak[start : start + BLOCK] @ gain[start : start + BLOCK]
    return mass / max(float(weak.sum()), 1e-8)
