"""Which places a camera sees: what lies in its image (`in_frustum`), and what of a surface it sees (`seen_from`).

A camera sees a place whose front faces it at no more than a largest incidence and which the mesh does not hide. Whether
that also lies in the image is a question of its own, since some let the camera turn. Of sparse points all that lies in the
image counts, as in the paper: inside the image of an exact zero-roll camera aimed at the target, so also behind the rock.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from nbv.config import CameraConfig
from nbv.geometry.frames import directions_from
from nbv.geometry.raycasting import RayCaster, rays_of
from nbv.types import Bools, Floats, Floats32

SURFACE_OFFSET_M = 1e-4  # lifts a ray off the facet that it starts from
# How slanted a surface may be seen: the largest angle between its normal and the line of sight, one for each question.
MATCHABLE_MAX_INCIDENCE_DEG = 75.0  # to plan views by: beyond this a photograph says little about the surface
OBSERVABLE_MAX_INCIDENCE_DEG = 80.0  # to evaluate on: beyond this it is foreshortened more than 5.8 times
LANDMARK_MAX_INCIDENCE_DEG = 86.0  # of the simulator's landmarks; detection has limits of its own
BLOCK = 256  # points at a time: a block's (BLOCK, C) arrays stay in the processor's cache


def in_frustum(points_m: Floats, positions_m: Floats, target_m: Floats, camera: CameraConfig) -> Bools:
    """(P, C): is each point (P, 3) in the image of the camera at each position (C, 3), aimed at the target (3,)?

    The principal point is the image's centre: a point is inside where neither of its scaled coordinates across the line of
    sight exceeds its depth.
    """
    right, down, forward = camera_axes(positions_m, target_m)
    x, y, z = (
        scale * np.concatenate([axis.T, -np.einsum("ij,ij->i", axis, positions_m)[None]])
        for axis, scale in (
            (right, camera.focal_px / (camera.width_px / 2.0)),
            (down, camera.focal_px / (camera.height_px / 2.0)),
            (forward, 1.0),
        )
    )
    homogeneous = np.column_stack([points_m, np.ones(len(points_m))])
    visible = np.empty((len(points_m), len(positions_m)), dtype=bool)
    for start in range(0, len(points_m), BLOCK):
        block = homogeneous[start : start + BLOCK]
        off_axis = np.maximum(np.abs(block @ x), np.abs(block @ y))
        visible[start : start + BLOCK] = off_axis <= block @ z
    return visible


def camera_axes(positions_m: Floats, target_m: Floats) -> tuple[Floats, Floats, Floats]:
    """(C, 3) each: right, down and forward of `nbv.geometry.frames.look_at` for every position at once."""
    forward = directions_from(positions_m, target_m)
    right = np.cross(forward, (0.0, 0.0, 1.0))
    straight = np.linalg.norm(right, axis=1) < 1e-9  # up or down: the image's up is north
    right[straight] = np.cross(forward[straight], (0.0, 1.0, 0.0))
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    return right, np.cross(forward, right), forward


def incidences_deg(points_m: NDArray[Any], normals: NDArray[Any], cameras_m: NDArray[Any]) -> Floats32:
    """(V, P) angles between the normals (P, 3) of places (P, 3) and the lines of sight from these to cameras (V, 3)."""
    # (c - p) . n / |c - p| by products of matrices: several times as fast as difference by difference.
    cosine = cameras_m @ normals.T - np.einsum("ij,ij->i", points_m, normals)
    squared = (cameras_m**2).sum(axis=1)[:, None] + (points_m**2).sum(axis=1) - 2.0 * cameras_m @ points_m.T
    cosine = (cosine / np.sqrt(squared)).astype(np.float32)
    return np.rad2deg(np.arccos(np.clip(cosine, -1.0, 1.0)))


def seen_from(
    center_m: Floats, starts_m: Floats, normals: Floats, caster: RayCaster, max_incidence_deg: float
) -> Bools:
    """(P,) does the camera at ``center_m`` (3,) see each place?

    ``starts_m`` (P, 3) are the places lifted off the surface (`SURFACE_OFFSET_M`), ``normals`` (P, 3) unit and outward, ``caster`` the mesh that
    may hide them. The angle between normal and direction to the camera is at most ``max_incidence_deg``.
    """
    to_camera = center_m - starts_m
    distance_m = np.linalg.norm(to_camera, axis=1)
    seen: Bools = (to_camera * normals).sum(axis=1) >= (np.cos(np.deg2rad(max_incidence_deg)) * distance_m)
    ask = np.flatnonzero(seen)
    # Directions are not normalised, so the camera is one length away.
    seen[ask[caster.blocked(rays_of(starts_m[ask], to_camera[ask]), reach=1.0)]] = False
    return seen
