"""The reference surface of a rock is made once and kept by what decides it."""

import dataclasses

import numpy as np
import pytest
import trimesh

from nbv.cache import Store
from nbv.config import MissionConfig
from nbv.evaluation.evaluate import ground_truth, rock_floors
from nbv.rocks.rock import make_rock


@pytest.fixture(scope="module")
def rock():
    mesh = trimesh.creation.icosphere(subdivisions=3, radius=0.8)
    vertices = np.asarray(mesh.vertices) + np.array([0.0, 0.0, 0.8])
    albedo = np.full((len(vertices), 3), 0.2, np.float32)
    return make_rock("ball", vertices, np.asarray(mesh.faces), albedo, split="extra", difficulty="round")


def test_kept_by_rock_shell_and_options(rock, tmp_path, monkeypatch):
    config = MissionConfig().with_values({"evaluation.gt_samples": 2000, "dense.fusion_voxel_m": 0.05})
    store = Store(tmp_path / "store")
    fresh = ground_truth(rock, config)
    floors = rock_floors(rock, fresh, config)
    for _ in range(2):
        truth = ground_truth(rock, config, store)
        assert np.array_equal(truth.points_m, fresh.points_m) and np.array_equal(truth.normals, fresh.normals)
        assert np.array_equal(truth.observable, fresh.observable)
        assert rock_floors(rock, truth, config, store) == floors
    assert [(kind.kind, kind.entries) for kind in store.info()] == [("floors", 1), ("ground-truth", 1)]

    for other in ({"evaluation.gt_samples": 1000}, {"pool.radius_m": 4.0}):
        ground_truth(rock, config.with_values(other), store)
    ground_truth(dataclasses.replace(rock, sha256="0" * 64), config, store)
    coarser = rock_floors(rock, fresh, config.with_values({"dense.fusion_voxel_m": 0.1}), store)
    assert coarser != floors
    assert [(kind.kind, kind.entries) for kind in store.info()] == [("floors", 2), ("ground-truth", 4)]
