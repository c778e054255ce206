"""A deployable occlusion test: from the sparse points and their observing rays alone.

Every point becomes a surfel: a disc with the normal of its neighbourhood (principal components), turned
towards the cameras that observed it, one and a half times as wide as the local spacing. A point in the frustum counts as
visible if the candidate looks at the surfel's front and no other surfel stands in the way.

The constants below were chosen on real models of two training rocks, Apollo 15016 and 65035, against ray
casting on the true meshes: ``benchmarks/occlusion_quality.py`` prints how well the test does. The normal
settles the rock's own far side, the surfels what the rock hides.
"""

from __future__ import annotations

import numpy as np
import open3d as o3d
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from nbv.types import Floats, Ints

NORMAL_NEIGHBOURS = 16
SPACING_NEIGHBOURS = 5
RADIUS_SPACINGS = 1.5
MAX_RADIUS_M = 0.12  # isolated points must not become walls
MAX_INCIDENCE_DEG = 85.0
CLEARANCE_M = 0.3  # a ray is free this far from its point: neighbours on the same surface do not hide it
RIM = 6  # a disc is a hexagon
BATCH = 1 << 18  # rays at a time


def mean_observing_directions(
    points_m: Floats, track_offsets: Ints, track_cameras: Ints, camera_centers_m: Floats
) -> Floats:
    """(P, 3) unit mean of the directions from each point (with one ray or more) to its cameras."""
    point = np.repeat(np.arange(len(points_m)), np.diff(track_offsets))
    to_camera = camera_centers_m[track_cameras] - points_m[point]
    to_camera /= np.linalg.norm(to_camera, axis=1, keepdims=True)
    mean = np.add.reduceat(to_camera, track_offsets[:-1], axis=0)
    return mean / np.maximum(np.linalg.norm(mean, axis=1, keepdims=True), 1e-12)


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


def _disc_scene(points_m: Floats, normals: Floats, radius_m: Floats) -> o3d.t.geometry.RaycastingScene:
    helper = np.where(np.abs(normals[:, :1]) < 0.9, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]])
    u = np.cross(normals, helper)
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    v = np.cross(normals, u)
    angle = 2 * np.pi * np.arange(RIM) / RIM
    rim = np.cos(angle)[None, :, None] * u[:, None] + np.sin(angle)[None, :, None] * v[:, None]
    vertices = points_m[:, None] + radius_m[:, None, None] * rim
    fan = np.array([[0, i, i + 1] for i in range(1, RIM - 1)])
    faces = (RIM * np.arange(len(points_m)))[:, None, None] + fan
    scene = o3d.t.geometry.RaycastingScene(nthreads=1)
    scene.add_triangles(
        o3d.core.Tensor.from_numpy(vertices.reshape(-1, 3).astype(np.float32)),
        o3d.core.Tensor.from_numpy(faces.reshape(-1, 3).astype(np.uint32)),
    )
    return scene


def unoccluded(
    in_frustum: NDArray[np.bool_],
    points_m: Floats,
    track_offsets: Ints,
    track_cameras: Ints,
    camera_centers_m: Floats,
    candidates_m: Floats,
) -> NDArray[np.bool_]:
    """(P, C): ``in_frustum`` without the points whose back is seen or which surfels hide."""
    observing = mean_observing_directions(points_m, track_offsets, track_cameras, camera_centers_m)
    normals, radius = surfels(points_m, observing)
    # normal . (c - p) > cos(limit) |c - p|
    facing = normals @ candidates_m.T - np.einsum("ij,ij->i", normals, points_m)[:, None]
    squared = (
        (points_m**2).sum(axis=1)[:, None]
        + (candidates_m**2).sum(axis=1)[None]
        - 2.0 * points_m @ candidates_m.T
    )
    distance = np.sqrt(np.maximum(squared, 0.0))
    visible = in_frustum & (facing > np.cos(np.deg2rad(MAX_INCIDENCE_DEG)) * distance)

    scene = _disc_scene(points_m, normals, radius)
    rows, columns = np.nonzero(visible)
    for start in range(0, len(rows), BATCH):
        i, j = rows[start : start + BATCH], columns[start : start + BATCH]
        rays = np.empty((len(i), 6), dtype=np.float32)
        direction = (candidates_m[j] - points_m[i]) / distance[i, j][:, None]
        rays[:, :3] = points_m[i] + CLEARANCE_M * direction
        rays[:, 3:] = direction
        hit = scene.test_occlusions(o3d.core.Tensor.from_numpy(rays), nthreads=1).numpy()
        visible[i[hit], j[hit]] = False
    return visible
