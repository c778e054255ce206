"""The reference surface and the registration to it, on shapes where both are known."""

import dataclasses
import sys
from collections import Counter
from pathlib import Path

import numpy as np
import open3d as o3d
import pytest
import trimesh
from scene_helpers import around
from scipy.spatial.transform import Rotation

from nbv.cache import Store
from nbv.config import MissionConfig, preset
from nbv.evaluation import evaluate_cloud
from nbv.evaluation.ground_truth import (
    ground_share,
    ground_truth,
    observable_mask,
    rock_floors,
)
from nbv.geometric.world import SURFACE_SAMPLES, world_of
from nbv.geometry.frames import Similarity
from nbv.geometry.mesh import RayCaster, drop_unused_vertices, face_areas, sample_surface
from nbv.rocks import Rock
from nbv.rocks.rock import make_rock
from nbv.types import PointCloud


def mesh_arrays(mesh):
    return np.asarray(mesh.vertices), np.asarray(mesh.triangles).astype(np.int64)


def test_single_camera_sees_a_sphere_up_to_the_incidence_limit():
    vertices, faces = mesh_arrays(o3d.geometry.TriangleMesh.create_sphere(0.5, resolution=60))
    vertices = vertices + np.array([0, 0, 10.0])
    points, normals = sample_surface(vertices, faces, 20_000, 0)
    camera = np.array([[1000.0, 0, 10.0]])
    assert not observable_mask(
        RayCaster(vertices, faces), points, normals, camera
    ).any()  # two views are needed
    seen = observable_mask(RayCaster(vertices, faces), points, normals, np.repeat(camera, 2, 0))
    # From far away the cap with incidence below 80 degrees: (1 - cos 80) / 2 of the sphere.
    assert seen.mean() == pytest.approx((1 - np.cos(np.deg2rad(80))) / 2, abs=0.01)
    assert points[seen, 0].min() == pytest.approx(0.5 * np.cos(np.deg2rad(80)), abs=0.03)


def test_underside_ground_and_occluded_parts_are_not_observable():
    box = o3d.geometry.TriangleMesh.create_box(1, 1, 1).translate((-0.5, -0.5, 0.2))  # floats: a bottom face
    buried = o3d.geometry.TriangleMesh.create_box(0.2, 0.2, 0.3).translate((2.0, 2.0, -0.2))
    inside = o3d.geometry.TriangleMesh.create_sphere(0.2).translate((0, 0, 0.7))
    vertices, faces = mesh_arrays(box + buried + inside)
    points, normals = sample_surface(vertices, faces, 20_000, 0)
    cameras = np.concatenate([around(np.arange(0, 360, 15), e) for e in (10, 35, 55)])
    seen = observable_mask(RayCaster(vertices, faces), points, normals, cameras)
    top, bottom = (normals[:, 2] > 0.99), (normals[:, 2] < -0.99) & (np.abs(points[:, 2] - 0.2) < 1e-6)
    in_sphere = np.linalg.norm(points - [0, 0, 0.7], axis=1) < 0.21
    assert seen[top & ~in_sphere & (points[:, 2] > 0.9)].all()
    assert bottom.any() and not seen[bottom].any()
    assert in_sphere.any() and not seen[in_sphere].any()
    assert not seen[points[:, 2] < 0].any()


VOXEL_M, CUT_M = 0.02, 0.03


@pytest.fixture(scope="module")
def standing_box():
    """A box of 1 x 1 x 0.8 m on the ground: its bottom is never visible."""
    box = o3d.geometry.TriangleMesh.create_box(1.0, 1.0, 0.8).translate((-0.5, -0.5, 0.0))
    vertices, faces = mesh_arrays(box)
    rock = make_rock("box", vertices, faces, 0 * vertices, split="extra", difficulty="")
    config = preset("campaign").with_values(
        {
            "evaluation.gt_samples": 20_000,
            "dense.fusion_voxel_m": VOXEL_M,
            "evaluation.ground_ransac_threshold_m": CUT_M,
        }
    )
    truth = ground_truth(rock, config)
    return rock, truth, rock_floors(rock, truth, config)


def test_the_middle_of_an_invisible_bottom_is_the_floor(standing_box):
    *_, floors = standing_box
    # The centre of a 1 m square bottom is 0.5 m from its edges, where the visible sides begin 3 cm higher up.
    expected = 1000 * np.hypot(0.5, CUT_M)
    assert floors["whole"]["hausdorff_gt_to_cloud_floor_mm"] == pytest.approx(expected, abs=15)
    assert (
        floors["whole"]["hausdorff_symmetric_floor_mm"] == floors["whole"]["hausdorff_gt_to_cloud_floor_mm"]
    )
    # On the observable part only the ground cut and the gaps between voxels are left.
    observable = floors["observable"]["hausdorff_gt_to_cloud_floor_mm"]
    assert 1000 * CUT_M - 2 < observable < 1000 * (CUT_M + 2 * VOXEL_M)
    # Averaging pulls points off the surface at edges only, by less than a voxel.
    assert floors["whole"]["hausdorff_cloud_to_gt_floor_mm"] < 1000 * VOXEL_M


def dome_on_ground(*, ground_m=3.0, tilt_deg=0.0, bumps_m=0.0):
    """A dome of 1.3 m across and 0.9 m height in one sheet with ground, as a scan has it; ``ground_m`` 0: the dome alone."""
    side = np.linspace(-1, 1, 61) * max(ground_m, 1.3) / 2
    x, y = (a.ravel() for a in np.meshgrid(side, side))
    radius = np.hypot(x, y) / 0.65
    level = np.tan(np.deg2rad(tilt_deg)) * x + bumps_m * np.sin(9 * x) * np.cos(8 * y)
    vertices = np.stack(
        [x, y, np.where(radius < 1, 0.9 * np.sqrt(np.maximum(1 - radius**2, 0)), level)], axis=1
    )
    k = (np.arange(60)[:, None] * 61 + np.arange(60)).ravel()
    faces = np.concatenate([[k, k + 1, k + 61], [k + 1, k + 62, k + 61]], axis=1).T
    if not ground_m:
        faces = faces[(radius[faces] < 1).any(axis=1)]
    vertices, faces = drop_unused_vertices(vertices, faces)
    vertices[:, 2] -= vertices[:, 2].min()
    return make_rock("scan", vertices, faces, 0 * vertices + 0.3, split="extra", difficulty="")


GROUNDS = [{}, {"tilt_deg": 4.0}, {"ground_m": 2.2}, {"ground_m": 4.0, "bumps_m": 0.01}]
SMALL = preset("campaign").with_values({"evaluation.gt_samples": 5_000})


@pytest.mark.parametrize("ground", GROUNDS, ids=str)
def test_truth_and_cloud_lose_the_same_ground(ground, monkeypatch):
    rock = dome_on_ground(**ground)
    points, normals = sample_surface(rock.vertices_m, rock.faces, 40_000, 3)
    beside = np.random.default_rng(0).uniform(-1.5, 1.5, (12_000, 2))
    beside = beside[np.abs(beside).max(axis=1) > np.abs(points[:, :2]).max()]
    beside = np.column_stack([beside, np.zeros(len(beside))])
    cloud = PointCloud(
        np.concatenate([points, beside]), None, np.concatenate([normals, 0 * beside + [0, 0, 1]])
    )
    share = ground_share(rock, SMALL.evaluation)
    area = {part: sum_of_areas(made) for part, made in (("all", rock), ("dome", dome_on_ground(ground_m=0)))}
    assert share == pytest.approx(1 - area["dome"] / area["all"], abs=0.06)
    measured = evaluate_cloud(cloud, rock, SMALL).metrics["whole"]
    assert measured["f_score_48mm"] > 98
    # As it was: the cloud lost its ground, and the truth kept it.
    monkeypatch.setattr(sys.modules["nbv.evaluation.ground_truth"], "LEAST_GROUND", 2.0)
    assert evaluate_cloud(cloud, rock, SMALL).metrics["whole"]["f_score_48mm"] < 90
    assert ground_share(rock, SMALL.evaluation) == 0


def sum_of_areas(rock):
    return face_areas(rock.vertices_m, rock.faces).sum()


def test_a_geometric_mission_measures_no_ground():
    rock = dome_on_ground(tilt_deg=4.0)
    samples = world_of(rock, SMALL, None).samples_m
    assert len(samples) == SURFACE_SAMPLES
    assert (np.hypot(*samples[:, :2].T) < 0.68).mean() > 0.95


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
