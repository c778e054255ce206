"""A deployable occlusion test: from the sparse points and their observing rays alone.

Every point becomes a surfel: a disc with the normal of its neighbourhood (principal components), turned
towards the cameras that observed it, one and a half times as wide as the local spacing. A point in the frustum counts as
visible if the candidate looks at the surfel's front and no other surfel stands in the way.

The constants below were chosen on real models of two training rocks, Apollo 15016 and 65035, against ray
casting on the true meshes (``research/occlusion_quality.py`` at 98aed9d). The normal
settles the rock's own far side, the surfels what the rock hides.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from nbv.geometry.raycasting import RayCaster, rays_of
from nbv.geometry.visibility import SURFEL_MAX_INCIDENCE_DEG
from nbv.scorers.box import BoxPoints
from nbv.types import Bools, Floats

NORMAL_NEIGHBOURS = 16
SPACING_NEIGHBOURS = 5
RADIUS_SPACINGS = 1.5
MAX_RADIUS_M = 0.12  # isolated points must not become walls
CLEARANCE_M = 0.3  # a ray is free this far from its point: neighbours on the same surface do not hide it
RIM = 6  # a disc is a hexagon
BLOCK = 1024  # points at a time


def mean_observing_directions(box: BoxPoints) -> Floats:
    """(P, 3) unit mean of the directions from each point (with one ray or more) to its cameras."""
    point = np.repeat(np.arange(len(box.points_m)), box.track_lengths)
    to_camera = np.ascontiguousarray(box.camera_centers_m.T).take(box.track_cameras, axis=1)
    to_camera -= np.ascontiguousarray(box.points_m.T).take(point, axis=1)
    to_camera /= np.sqrt((to_camera**2).sum(axis=0))
    mean = np.add.reduceat(to_camera, box.track_offsets[:-1], axis=1)
    return np.ascontiguousarray((mean / np.maximum(np.sqrt((mean**2).sum(axis=0)), 1e-12)).T)


def surfels(points_m: Floats, observing: Floats) -> tuple[Floats, Floats]:
    """(P, 3) unit normals on the observed side and (P,) disc radii in metres.

    With fewer than 4 points there is no neighbourhood: the normal is the observing direction itself.
    """
    if len(points_m) < 4:
        return observing, np.zeros(len(points_m))
    neighbours = min(NORMAL_NEIGHBOURS, len(points_m) - 1)
    distance, index = cKDTree(points_m, balanced_tree=False).query(points_m, k=neighbours + 1)
    spacing = distance[:, 1 : SPACING_NEIGHBOURS + 1].mean(axis=1)
    radius = np.minimum(RADIUS_SPACINGS * spacing, MAX_RADIUS_M)
    around = points_m[index]
    around -= around.mean(axis=1, keepdims=True)
    _, vectors = np.linalg.eigh(around.transpose(0, 2, 1) @ around)
    normal = vectors[:, :, 0]
    return np.where(((normal * observing).sum(axis=1) < 0)[:, None], -normal, normal), radius


def discs(points_m: Floats, normals: Floats, radius_m: Floats) -> RayCaster:
    """Every surfel as a hexagon that rays can meet."""
    helper = np.where(np.abs(normals[:, :1]) < 0.9, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]])
    u = np.cross(normals, helper)
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    v = np.cross(normals, u)
    angle = 2 * np.pi * np.arange(RIM) / RIM
    rim = np.cos(angle)[None, :, None] * u[:, None] + np.sin(angle)[None, :, None] * v[:, None]
    vertices = points_m[:, None] + radius_m[:, None, None] * rim
    fan = np.array([[0, i, i + 1] for i in range(1, RIM - 1)])
    faces = (RIM * np.arange(len(points_m)))[:, None, None] + fan
    return RayCaster(vertices.reshape(-1, 3), faces.reshape(-1, 3))


def unoccluded(in_frustum: Bools, box: BoxPoints, candidates_m: Floats) -> Bools:
    """(P, C): ``in_frustum`` (P, C) without the points whose back a candidate (C, 3) sees or which surfels hide."""
    points_m = box.points_m
    normals, radius = surfels(points_m, mean_observing_directions(box))
    walls = discs(points_m, normals, radius)
    min_cosine = np.cos(np.deg2rad(SURFEL_MAX_INCIDENCE_DEG))
    visible = in_frustum.copy()
    for start in range(0, len(points_m), BLOCK):
        rows = slice(start, start + BLOCK)
        to_candidate = candidates_m[None] - points_m[rows][:, None]
        distance = np.linalg.norm(to_candidate, axis=2)
        facing = np.einsum("pck,pk->pc", to_candidate, normals[rows])
        seen = visible[rows]
        seen &= facing > min_cosine * distance
        i, j = np.nonzero(seen)
        direction = to_candidate[i, j] / distance[i, j][:, None]
        rays = rays_of(points_m[rows][i] + CLEARANCE_M * direction, direction)
        hit = walls.blocked(rays)
        seen[i[hit], j[hit]] = False
    return visible
