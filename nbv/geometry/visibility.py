"""The one visibility test: which places of a surface a camera sees.

A camera sees a place whose front faces it at no more than a largest incidence and which the mesh does not hide.
Whether it also lies in the image is a question of its own (`nbv.geometry.frustum`), since some askers let the
camera turn.
"""

from __future__ import annotations

import numpy as np

from nbv.geometry.raycasting import RayCaster, rays_of
from nbv.types import Bools, Floats

SURFACE_OFFSET_M = 1e-4  # lifts a ray off the facet that it starts from
# How slanted a surface may be seen: the largest angle between its normal and the line of sight, one for each question.
MATCHABLE_MAX_INCIDENCE_DEG = 75.0  # to plan views by: beyond this a photograph says little about the surface
OBSERVABLE_MAX_INCIDENCE_DEG = 80.0  # to evaluate on: beyond this it is foreshortened more than 5.8 times
LANDMARK_MAX_INCIDENCE_DEG = 86.0  # of the simulator's landmarks; detection has limits of its own


def lifted(points_m: Floats, normals: Floats, offset_m: float = SURFACE_OFFSET_M) -> Floats:
    """(P, 3) where the rays of places (P, 3) with unit outward normals (P, 3) start."""
    return points_m + offset_m * normals


def seen_from(
    center_m: Floats, starts_m: Floats, normals: Floats, caster: RayCaster, max_incidence_deg: float
) -> Bools:
    """(P,) does the camera at ``center_m`` (3,) see each place?

    ``starts_m`` (P, 3) are the places lifted off the surface (`lifted`), ``normals`` (P, 3) unit and outward, ``caster`` the mesh that
    may hide them. The angle between normal and direction to the camera is at most ``max_incidence_deg``.
    """
    to_camera = center_m - starts_m
    distance_m = np.linalg.norm(to_camera, axis=1)
    seen: Bools = (to_camera * normals).sum(axis=1) >= (np.cos(np.deg2rad(max_incidence_deg)) * distance_m)
    ask = np.flatnonzero(seen)
    # Directions are not normalised, so the camera is one length away.
    seen[ask[caster.blocked(rays_of(starts_m[ask], to_camera[ask]), reach=1.0)]] = False
    return seen
