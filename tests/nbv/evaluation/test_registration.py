"""Registration against known offsets; both numbers of an evaluation, as georeferenced and registered; its reference."""

import dataclasses
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from nbv.cache import Store
from nbv.config import MissionConfig, preset
from nbv.evaluation import evaluate_cloud, ground_truth
from nbv.evaluation.ground_truth import rock_floors
from nbv.geometry.frames import Similarity
from nbv.rocks import Rock
from nbv.rocks.rock import make_rock
from nbv.types import PointCloud

CONFIG = preset("campaign").with_values({"telemetry": "gnss", "evaluation.gt_samples": 2000})


def bumpy(d: np.ndarray) -> np.ndarray:
    """(N, 3) directions on a bumpy ellipsoid without symmetry, 1.6 m tall."""
    bumps = 1 + 0.15 * np.sin(3 * d[:, 0] + 1) * np.cos(4 * d[:, 1]) + 0.1 * np.sin(5 * d[:, 2] + 2 * d[:, 0])
    return d * bumps[:, None] * [0.6, 0.7, 0.8]


@pytest.fixture(scope="module")
def rock() -> Rock:
    mesh = trimesh.creation.icosphere(subdivisions=3, radius=1.0)
    vertices = bumpy(np.asarray(mesh.vertices))
    vertices[:, 2] -= vertices[:, 2].min()
    albedo = np.full((len(vertices), 3), 0.2, np.float32)
    return make_rock("bumpy", vertices, np.asarray(mesh.faces), albedo, split="extra", difficulty="round")


def dense_cloud(rock: Rock) -> np.ndarray:
    """(N, 3) the rock without its underside, on the patch of ground that a dense crop holds."""
    rng = np.random.default_rng(4)
    points = trimesh.Trimesh(rock.vertices_m, rock.faces).sample(12_000, seed=1)
    ground = np.c_[rng.uniform(-1.3, 1.3, (5_000, 2)), rng.normal(0, 0.004, 5_000)]
    return np.concatenate([points[points[:, 2] > 0.2], ground])


@pytest.mark.slow
def test_a_known_offset_costs_the_registered_number_nothing(rock: Rock, tmp_path: Path) -> None:
    store = Store(tmp_path)
    turn = Rotation.from_euler("xyz", (2.0, -1.0, 4.5), degrees=True).as_matrix()
    displaced = Similarity(1.03, turn, np.array([0.8, -0.6, 0.3])).apply(dense_cloud(rock))
    exact = CONFIG.with_values({"telemetry": "exact"})  # registers nothing
    right = evaluate_cloud(PointCloud(dense_cloud(rock)), rock, exact, store).metrics
    found = evaluate_cloud(PointCloud(displaced), rock, CONFIG, store).metrics
    registered = found["registered"]
    assert found["whole"]["f_score_48mm"] < right["whole"]["f_score_48mm"] - 20
    for surface in ("whole", "observable"):
        assert abs(right[surface]["f_score_48mm"] - registered[surface]["f_score_48mm"]) < 1.0
    assert registered["scale"] == pytest.approx(1 / 1.03, abs=0.005)
    assert registered["turn_deg"] == pytest.approx(
        np.rad2deg(Rotation.from_matrix(turn).magnitude()), abs=0.5
    )


def test_the_reference_is_kept_by_rock_shell_and_options(rock: Rock, tmp_path: Path) -> None:
    config = MissionConfig().with_values({"evaluation.gt_samples": 2000, "dense.fusion_voxel_m": 0.05})
    store = Store(tmp_path / "store")
    fresh = ground_truth(rock, config)
    floors = rock_floors(rock, fresh, config)
    for _ in range(2):
        truth = ground_truth(rock, config, store)
        assert np.array_equal(truth.points_m, fresh.points_m)
        assert np.array_equal(truth.observable, fresh.observable)
        assert rock_floors(rock, truth, config, store) == floors
    assert Counter(path.parts[-3] for path in store.root.glob("*/??/*")) == {"floors": 1, "ground-truth": 1}

    # The pool may be tuned: the truth is the same for it.
    for other in ({"evaluation.gt_samples": 1000}, {"pool.radius_m": 4.0}):
        ground_truth(rock, config.with_values(other), store)
    ground_truth(dataclasses.replace(rock, sha256="0" * 64), config, store)
    coarser = rock_floors(rock, fresh, config.with_values({"dense.fusion_voxel_m": 0.1}), store)
    assert coarser != floors
    assert Counter(path.parts[-3] for path in store.root.glob("*/??/*")) == {"floors": 2, "ground-truth": 3}
