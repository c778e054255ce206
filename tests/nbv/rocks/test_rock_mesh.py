"""Refinement and bodies."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from nbv.rocks import mesh as meshes
from nbv.rocks.rock import content_hash


@settings(max_examples=25)
@given(st.integers(0, 10_000), st.floats(0.05, 0.8))
def test_refine_keeps_the_surface_and_closes_every_seam(seed, max_edge):
    points = np.random.default_rng(seed).normal(size=(12, 3)) * [1, 0.6, 0.3]
    hull = trimesh.convex.convex_hull(points)
    vertices, faces = np.asarray(hull.vertices), np.asarray(hull.faces, dtype=np.int64)
    values, fine_faces = meshes.refine(np.hstack([vertices, 2 * vertices]), faces, max_edge)
    fine = values[:, :3]
    corners = fine[fine_faces]
    assert np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2).max() <= max_edge
    assert (meshes.edge_face_counts(fine_faces) == 2).all()
    np.testing.assert_allclose(values[:, 3:], 2 * fine, atol=1e-12)  # what vertices carry is interpolated
    assert meshes.face_areas(fine, fine_faces).sum() == pytest.approx(hull.area)
    assert meshes.signed_volume(fine, fine_faces) == pytest.approx(hull.volume)


def test_content_hash_ignores_the_last_bits_and_nothing_else():
    vertices = np.random.default_rng(0).uniform(size=(5, 3)).round(3)
    faces = np.array([[0, 1, 2], [2, 3, 4]])
    albedo = np.full((5, 3), 0.5, dtype=np.float32)
    digest = content_hash(vertices, faces, albedo)
    assert content_hash(vertices + 1e-12, faces, albedo) == digest
    assert content_hash(vertices + 1e-5, faces, albedo) != digest
    assert content_hash(vertices, faces[:, ::-1], albedo) != digest
    assert content_hash(vertices, faces, albedo * 1.01) != digest
