"""A closed-looking surface of the dense reference, so that a set can stand where a rock may stand."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from nbv.errors import UserError
from nbv.photographs.reference_file import Reference
from nbv.rocks import Rock
from nbv.rocks.mesh import body_labels, drop_unused_vertices, face_areas
from nbv.rocks.rock import make_rock
from nbv.rocks.texture import linear_from_srgb

DEPTH = 8  # of the octree: cells of 1/256 of the object
REACH = 0.06  # of the height: surface farther from any reference point is invention and left out
_MOST_POINTS = 300_000


def surface_of(reference: Reference, name: str, height_m: float) -> Rock:
    """Screened Poisson reconstruction (Kazhdan and Hoppe 2013, Open3D's), cut off where there are no points.

    Raises
    ------
    UserError
        The reference is too small for a surface.
    """
    import open3d as o3d  # noqa: PLC0415  seconds to load

    step = max(1, len(reference) // _MOST_POINTS)
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(reference.points_m[::step]))
    cloud.normals = o3d.utility.Vector3dVector(reference.normals[::step])
    mesh, _ = o3d.geometry.TriangleMesh.create_from_point_cloud_poisson(cloud, depth=DEPTH, n_threads=1)
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.triangles).astype(np.int64)
    away, nearest = cKDTree(reference.points_m).query(vertices)
    faces = faces[(away[faces] <= REACH * height_m).all(axis=1)]
    if len(faces):
        labels = body_labels(faces)
        areas = np.bincount(labels, weights=face_areas(vertices, faces))
        faces = faces[areas[labels] >= 0.05 * areas.max()]
    if len(faces) < 100:
        raise UserError("the reference has too few points for a surface; give more photographs of the object")
    albedo = linear_from_srgb(reference.colors[nearest] / 255.0)
    numbered = np.arange(len(vertices))
    placed, faces_kept = drop_unused_vertices(vertices, faces)
    used = drop_unused_vertices(numbered[:, None].astype(float), faces)[0][:, 0].astype(np.int64)
    return make_rock(
        name,
        placed,
        faces_kept,
        np.asarray(albedo)[used].astype(np.float32),
        split="extra",
        difficulty="meshed from photographs",
        notes=(f"Poisson surface of {len(reference)} reference points; open where nothing was seen",),
    )
