"""The terms that both scorers share: novelty (Eq. 2), movement (Eq. 3), angular penalty (Eq. 4)."""

from __future__ import annotations

import numpy as np
from scipy.spatial.distance import cdist

from nbv.geometry.frames import wrap_angle
from nbv.types import Floats


def _distances(a: Floats, b: Floats) -> Floats:
    distances: Floats = cdist(a, b)
    return distances


def novelty(candidates_m: Floats, visited_m: Floats, d_scale_m: float) -> Floats:
    """Eq. 2: (C,) distance to the nearest visited viewpoint over ``d_scale_m``, at most 1.

    ``visited_m`` (V, 3) counts seeds and adaptive captures; with none visited everything is new (1).
    """
    if len(visited_m) == 0:
        return np.ones(len(candidates_m))
    return np.minimum(1.0, _distances(candidates_m, visited_m).min(axis=1) / d_scale_m)


def movement(
    candidates_m: Floats,
    headings_rad: Floats,
    vehicle_position_m: Floats,
    vehicle_heading_rad: float,
    d_travel_m: float,
) -> Floats:
    """Eq. 3: (C,) straight-line travel and heading change from the vehicle's actual pose; unbounded.

    Parameters
    ----------
    candidates_m, headings_rad
        (C, 3) positions and (C,) headings there.
    vehicle_position_m, vehicle_heading_rad
        (3,) and a number: where the vehicle is.
    d_travel_m
        Travel that costs 0.7.
    """
    travel = np.linalg.norm(candidates_m - vehicle_position_m, axis=1)
    turn = np.abs(wrap_angle(headings_rad - vehicle_heading_rad))
    return 0.7 * travel / d_travel_m + 0.3 * turn / np.pi


def angular_penalty(
    candidates_m: Floats, visited_m: Floats, target_m: Floats, theta_min_deg: float
) -> Floats:
    """Eq. 4: (C,) 1 for a viewing direction already visited, falling to 0 at ``theta_min_deg``.

    A viewing direction is the unit vector from a viewpoint towards the target.

    Parameters
    ----------
    candidates_m, visited_m
        (C, 3) and (V, 3) positions.
    target_m
        (3,).
    theta_min_deg
        From this angle on there is no penalty.
    """
    if len(visited_m) == 0:
        return np.zeros(len(candidates_m))

    def directions(positions: Floats) -> Floats:
        delta = target_m - positions
        return delta / np.linalg.norm(delta, axis=1, keepdims=True)

    # Through the chord: an arc cosine loses half its digits where directions coincide.
    chord = _distances(directions(candidates_m), directions(visited_m)).min(axis=1)
    angle = 2.0 * np.arcsin(np.minimum(1.0, chord / 2.0))
    return np.maximum(0.0, 1.0 - angle / np.deg2rad(theta_min_deg))
