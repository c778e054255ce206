"""The reference surface and its observable part."""

import numpy as np
import open3d as o3d
import pytest

from nbv.evaluation.ground_truth import (
    observable_mask,
)
from nbv.geometry.sampling import sample_surface


def mesh_arrays(mesh):
    return np.asarray(mesh.vertices), np.asarray(mesh.triangles).astype(np.int64)


def ring(radius, elevation_deg, count=24, center=(0, 0, 0.8)):
    azimuth = np.linspace(0, 2 * np.pi, count, endpoint=False)
    elevation = np.deg2rad(elevation_deg)
    return np.array(center) + radius * np.stack(
        [
            np.cos(elevation) * np.cos(azimuth),
            np.cos(elevation) * np.sin(azimuth),
            np.full(count, np.sin(elevation)),
        ],
        axis=1,
    )


def test_single_camera_sees_a_sphere_up_to_the_incidence_limit():
    vertices, faces = mesh_arrays(o3d.geometry.TriangleMesh.create_sphere(0.5, resolution=60))
    vertices = vertices + np.array([0, 0, 10.0])
    points, normals = sample_surface(vertices, faces, 20_000, 0)
    camera = np.array([[1000.0, 0, 10.0]])
    assert not observable_mask(vertices, faces, points, normals, camera).any()  # two views are needed
    seen = observable_mask(vertices, faces, points, normals, np.repeat(camera, 2, 0))
    # From far away the cap with incidence below 80 degrees: (1 - cos 80) / 2 of the sphere.
    assert seen.mean() == pytest.approx((1 - np.cos(np.deg2rad(80))) / 2, abs=0.01)
    assert points[seen, 0].min() == pytest.approx(0.5 * np.cos(np.deg2rad(80)), abs=0.03)


def test_underside_ground_and_occluded_parts_are_not_observable():
    box = o3d.geometry.TriangleMesh.create_box(1, 1, 1).translate((-0.5, -0.5, 0.2))  # floats: a bottom face
    buried = o3d.geometry.TriangleMesh.create_box(0.2, 0.2, 0.3).translate((2.0, 2.0, -0.2))
    inside = o3d.geometry.TriangleMesh.create_sphere(0.2).translate((0, 0, 0.7))
    vertices, faces = mesh_arrays(box + buried + inside)
    points, normals = sample_surface(vertices, faces, 20_000, 0)
    cameras = np.concatenate([ring(3.5, e) for e in (10, 35, 55)])
    seen = observable_mask(vertices, faces, points, normals, cameras)
    top, bottom = (normals[:, 2] > 0.99), (normals[:, 2] < -0.99) & (np.abs(points[:, 2] - 0.2) < 1e-6)
    in_sphere = np.linalg.norm(points - [0, 0, 0.7], axis=1) < 0.21
    assert seen[top & ~in_sphere & (points[:, 2] > 0.9)].all()
    assert bottom.any() and not seen[bottom].any()
    assert in_sphere.any() and not seen[in_sphere].any()
    assert not seen[points[:, 2] < 0].any()
