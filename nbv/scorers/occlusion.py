"""A deployable occlusion test: from the sparse points and their observing rays alone.

Every point becomes a surfel: a disc with the normal of its neighbourhood (principal components), turned
towards the cameras that observed it, one and a half times as wide as the local spacing. A point in the frustum counts as
visible if the candidate looks at the surfel's front and no other surfel stands in the way.

The constants below were chosen on real models of two training rocks, Apollo 15016 and 65035, against ray
casting on the true meshes (``research/occlusion_quality.py`` at 98aed9d). The normal
settles the rock's own far side, the surfels what the rock hides.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.spatial import cKDTree

from nbv.geometry.raycasting import RayCaster
from nbv.geometry.visibility import SURFEL_MAX_INCIDENCE_DEG
from nbv.scorers.box import BoxPoints
from nbv.types import Bools, Floats, Ints

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
    offset = np.einsum("ij,ij->i", normals, points_m)
    p2, c2 = (points_m**2).sum(axis=1), (candidates_m**2).sum(axis=1)
    min_cosine = np.cos(np.deg2rad(SURFEL_MAX_INCIDENCE_DEG))
    visible = in_frustum.copy()
    for rows, obstacle in _by_height(points_m, normals, radius, candidates_m):
        p = points_m[rows]
        distance = p2[rows][:, None] + c2[None]
        distance -= 2.0 * p @ candidates_m.T
        np.sqrt(np.maximum(distance, 0.0, out=distance), out=distance)
        # normal . (c - p) > cos(limit) |c - p|
        facing = normals[rows] @ candidates_m.T - offset[rows][:, None]
        seen = in_frustum[rows] & (facing > min_cosine * distance)
        ask = seen if obstacle is None else seen & obstacle.may_hide(p, candidates_m)
        flat = np.flatnonzero(ask)
        i, j = np.divmod(flat.astype(np.int32), np.int32(len(candidates_m)))
        length = distance.ravel().take(flat)
        rays = np.empty((len(flat), 6), dtype=np.float32)
        for axis in range(3):
            start = p[:, axis].take(i)
            direction = (candidates_m[:, axis].take(j) - start) / length
            rays[:, axis] = start + CLEARANCE_M * direction
            rays[:, 3 + axis] = direction
        if len(flat):
            seen.ravel()[flat[walls.blocked(rays)]] = False
        visible[rows] = seen
    return visible


@dataclass(frozen=True)
class _Cylinder:
    """An upright cylinder around all discs that rise above some height."""

    center_m: Floats  # (2,)
    radius_m: float

    def may_hide(self, points_m: Floats, candidates_m: Floats) -> Bools:
        """(P, C) False where the half-line from the point through the candidate passes it by for certain.

        In single precision, with 1 mm to spare.
        """
        reach = self.radius_m + 1e-3
        u = (self.center_m - points_m[:, :2]).astype(np.float32)  # (P, 2)
        c = (candidates_m[:, :2] - self.center_m).astype(np.float32)  # (C, 2)
        # w = c - p = u + c in the plane. |u x w| / |w| is the line's distance from the axis.
        cross = u @ np.stack([c[:, 1], -c[:, 0]])
        u2 = (u**2).sum(axis=1)[:, None]
        along = u @ c.T
        w2 = u2 + 2.0 * along + (c**2).sum(axis=1)
        along += u2
        near = cross * cross <= np.float32(reach**2) * w2 + np.float32(1e-6)
        result: Bools = near & ((along >= -1e-5) | (u2 <= reach**2))
        return result


def _by_height(
    points_m: Floats, normals: Floats, radius_m: Floats, candidates_m: Floats
) -> Iterator[tuple[Ints, _Cylinder | None]]:
    """The points in blocks of like height, each with what rises above all rays of its block, if known.

    A ray that climbs from CLEARANCE_M on cannot meet a disc whose top is below its start.
    """
    # The lowest start of a point's rays: they climb least towards the lowest, farthest candidate.
    climb = candidates_m[:, 2].min() - points_m[:, 2]
    far = np.linalg.norm(points_m[:, :2] - candidates_m[:, :2].mean(axis=0), axis=1)
    far += np.linalg.norm(candidates_m[:, :2] - candidates_m[:, :2].mean(axis=0), axis=1).max()
    start_m = points_m[:, 2] + CLEARANCE_M * climb / np.hypot(far, climb)
    climbs = climb > 0
    order = np.concatenate([np.flatnonzero(~climbs), np.flatnonzero(climbs)[np.argsort(start_m[climbs])]])
    first = int(np.count_nonzero(~climbs))
    top = points_m[:, 2] + radius_m * np.sqrt(np.maximum(1.0 - normals[:, 2] ** 2, 0.0)) + 1e-4
    edges = [*range(0, first, BLOCK), *range(first, len(order), BLOCK), len(order)]
    for at, end in pairwise(edges):
        rows = order[at:end]
        if at < first:
            yield rows, None
            continue
        tall = np.flatnonzero(top >= start_m[rows[0]])
        if len(tall) == 0:
            yield rows, _Cylinder(np.zeros(2), -1e-3)
            continue
        xy = points_m[tall, :2]
        center = (xy.min(axis=0) + xy.max(axis=0)) / 2.0
        reach = float((np.linalg.norm(xy - center, axis=1) + radius_m[tall]).max())
        yield rows, _Cylinder(center, reach)
