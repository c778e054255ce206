"""Samples of a surface, even and the same in every run; the ray caster on a box, where every answer is known."""

import numpy as np
import pytest
import trimesh

from nbv.geometry.mesh import RayCaster, sample_surface, sample_surface_evenly


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
    even, normals = sample_surface_evenly(vertices, faces, 4000, 0)
    lower = even[even[:, 2] < 2.5]
    assert len(lower) == 1000  # one in each share
    assert np.allclose(even[:, 2], np.where(even[:, 2] > 2.5, 5, 0)) and np.allclose(normals, [0, 0, 1])
    assert np.allclose(lower[:, :2].mean(0), 1 / 3, atol=0.01)


def test_distances_to_the_surface_are_exact():
    mesh = trimesh.creation.box(extents=(2.0, 2.0, 2.0))
    points = np.array([[1.5, 0.0, 0.0], [0.0, 0.0, 0.25], [2.0, 2.0, 1.0], [1.0, 0.3, -0.2]])
    distances_m = RayCaster(mesh.vertices, mesh.faces).distances_m(points)
    np.testing.assert_allclose(distances_m, [0.5, 0.75, np.sqrt(2.0), 0.0], atol=1e-6)
