"""The ray caster on a box, where every answer is known."""

import numpy as np
import pytest
import trimesh

from nbv.geometry.raycasting import NO_FACE, RayCaster, rays_of


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
