"""Samples of a surface: even, and the same in every run."""

import numpy as np
import open3d as o3d
import pytest

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
