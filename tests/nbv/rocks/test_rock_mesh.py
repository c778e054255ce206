"""What a rock is known by."""

from __future__ import annotations

import numpy as np

from nbv.rocks.rock import content_hash


def test_content_hash_ignores_the_last_bits_and_nothing_else():
    vertices = np.random.default_rng(0).uniform(size=(5, 3)).round(3)
    faces = np.array([[0, 1, 2], [2, 3, 4]])
    albedo = np.full((5, 3), 0.5, dtype=np.float32)
    digest = content_hash(vertices, faces, albedo)
    assert content_hash(vertices + 1e-12, faces, albedo) == digest
    assert content_hash(vertices + 1e-5, faces, albedo) != digest
    assert content_hash(vertices, faces[:, ::-1], albedo) != digest
    assert content_hash(vertices, faces, albedo * 1.01) != digest
