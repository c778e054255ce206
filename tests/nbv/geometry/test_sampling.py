"""Samples of a surface, even and the same in every run; the ray caster on a box, where every answer is known."""

import numpy as np
import open3d as o3d
import pytest
import trimesh

from nbv.geometry.raycasting import NO_FACE, RayCaster, rays_of
from nbv.geometry.sampling import sample_surface, sample_surface_evenly


def test_samples_are_area_weighted_and_lie_on_the_surface():
    # Two triangles of areas 1/2 and 3/2, one of zero area between them.
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 5], [3, 0, 5], [0, 1, 5]], float)
    faces = np.array([[0, 1, 2], [0, 0, 1], [3, 4, 5]])
    points, normals = sample_surface(vertices, faces, 40_000, 0)
    upper = points[:, 2] > 2.5
    assert np.allclose(points[:, 2], np.where(upper, 5, 0))
    assert upper.mean() == pytest.approx(0.75, abs=0.01)
    assert np.allclose(normals, [0, 0, 1])
    lower = points[~upper]
    assert (lower[:, 0] + lower[:, 1]).max() <= 1 + 1e-12
    # Uniform within the triangle: the centroid, and a quarter of the area in the corner half as large.
    assert np.allclose(lower[:, :2].mean(0), 1 / 3, atol=0.01)
    assert np.mean(lower[:, 0] + lower[:, 1] < 0.5) == pytest.approx(0.25, abs=0.02)


def sphere():
    mesh = o3d.geometry.TriangleMesh.create_sphere(1.0)
    return np.asarray(mesh.vertices), np.asarray(mesh.triangles).astype(np.int64)


def test_samples_depend_on_the_seed_alone():
    vertices, faces = sphere()
    first, again, other = (sample_surface(vertices, faces, 500, s)[0] for s in (3, 3, 4))
    assert np.array_equal(first, again) and not np.array_equal(first, other)


def test_even_samples_lie_on_the_surface_one_in_each_share():
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 5], [3, 0, 5], [0, 1, 5]], float)
    faces = np.array([[0, 1, 2], [0, 0, 1], [3, 4, 5]])
    points, normals = sample_surface_evenly(vertices, faces, 4000, 0)
    lower = points[points[:, 2] < 2.5]
    assert (
        len(lower) == 1000
        and np.allclose(lower[:, 2], 0)
        and np.allclose(points[points[:, 2] > 2.5][:, 2], 5)
    )
    assert np.allclose(normals, [0, 0, 1])
    assert np.allclose(lower[:, :2].mean(0), 1 / 3, atol=0.01)


@pytest.fixture(scope="module")
def box():
    """A cube of 2 m around the origin; its arrays are read-only, as a rock's are."""
    mesh = trimesh.creation.box(extents=(2.0, 2.0, 2.0))
    vertices, faces = np.array(mesh.vertices), np.array(mesh.faces)
    vertices.setflags(write=False)
    faces.setflags(write=False)
    return RayCaster(vertices, faces)


def test_what_a_ray_meets_first(box):
    origins = np.array([[-3.0, 0.2, 0.3], [-3.0, 5.0, 0.0]])
    hits = box.cast(rays_of(origins, np.array([2.0, 0.0, 0.0])))
    np.testing.assert_allclose(hits.t, [1.0, np.inf])  # in lengths of the direction
    assert hits.face[0] != NO_FACE and hits.face[1] == NO_FACE
    grid = box.cast(np.zeros((4, 5, 6), dtype=np.float32) + rays_of(origins[0], np.array([1.0, 0.0, 0.0])))
    assert grid.t.shape == (4, 5) and grid.uv.shape == (4, 5, 2)


def test_a_ray_is_blocked_up_to_its_reach_only(box):
    rays = rays_of(np.array([-3.0, 0.2, 0.3]), np.array([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]]))
    assert box.blocked(rays).tolist() == [True, False]
    assert box.blocked(rays, reach=1.9).tolist() == [False, False]


def test_distances_to_the_surface_are_exact(box):
    points = np.array([[1.5, 0.0, 0.0], [0.0, 0.0, 0.25], [2.0, 2.0, 1.0], [1.0, 0.3, -0.2]])
    np.testing.assert_allclose(box.distances_m(points), [0.5, 0.75, np.sqrt(2.0), 0.0], atol=1e-6)
    places, normals = box.nearest(points)
    np.testing.assert_allclose(places[0], [1.0, 0.0, 0.0], atol=1e-6)
    np.testing.assert_allclose(normals[:2], [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]], atol=1e-6)
