"""Cleaning and scores: closed forms and properties."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial import cKDTree

from nbv.config import EvaluationConfig
from nbv.errors import MissionFailure
from nbv.evaluation.cleaning import clean_cloud, find_ground
from nbv.evaluation.ground_truth import GroundTruthSamples
from nbv.evaluation.registry import (
    Distances,
    azimuth_sectors,
    compute_metrics,
    measure_all,
    sector_centers_deg,
    share_by_sector,
)
from nbv.geometry.visibility import nearest_neighbours
from nbv.types import PointCloud

CONFIG = EvaluationConfig()
TARGET = (0.0, 0.0, 0.8)


def distance_scores(to_cloud_m, to_truth_m, thresholds_mm):
    """Every metric of two sets of distances."""
    config = dataclasses.replace(CONFIG, thresholds_mm=thresholds_mm)
    sectors = np.zeros(len(to_cloud_m), dtype=np.int64)
    return measure_all(Distances(1000.0 * to_cloud_m, 1000.0 * to_truth_m, sectors, config))


def truth_of(points, observable=None):
    return GroundTruthSamples(points, np.ones(len(points), bool) if observable is None else observable)


def measured(cloud, truth, config=CONFIG):
    to_gt_m, _ = nearest_neighbours(truth.points_m, cloud.points_m)
    return compute_metrics(cloud, truth, config, TARGET, to_gt_m)


def sphere(n, seed, radius=0.8):
    direction = np.random.default_rng(seed).normal(size=(n, 3))
    return radius * direction / np.linalg.norm(direction, axis=1, keepdims=True) + np.array(TARGET)


def plane(spacing=0.01, z=0.0):
    x, y = np.meshgrid(np.arange(-0.5, 0.5, spacing), np.arange(-0.5, 0.5, spacing))
    return np.stack([x.ravel(), y.ravel(), np.full(x.size, z)], axis=1)


def test_an_offset_plane_gives_its_offset_in_every_distance():
    scores = measured(PointCloud(plane(z=0.040)), truth_of(plane()), CONFIG)["whole"]
    for name in (
        "hausdorff_gt_to_cloud_mm",
        "hausdorff_cloud_to_gt_mm",
        "c2c_mean_mm",
        "c2c_median_mm",
        "c2c_p95_mm",
        "c2c_cloud_to_gt_mean_mm",
    ):
        assert scores[name] == pytest.approx(40.0), name
    assert [scores[f"f_score_{t}mm"] for t in (16, 32, 48, 64, 80)] == [0, 0, 100, 100, 100]
    # Trapezoids of 0, 0, 1, 1, 1 over four equal intervals: (0 + 1/2 + 1 + 1) / 4.
    assert scores["f_score_auc"] == pytest.approx(62.5)


def test_half_a_sphere_is_half_complete_and_fully_accurate():
    truth = sphere(40_000, 1)
    dense = sphere(200_000, 11)  # spacing of 6 mm, well under the smallest threshold
    cloud = dense[dense[:, 2] > TARGET[2]]
    scores = measured(PointCloud(cloud), truth_of(truth), CONFIG)["whole"]
    # The band below the equator that lies within t of its rim is complete as well: t / (2 R) of the area
    # to first order (a chord t spans the height t on a vertical wall).
    assert scores["completeness_16mm"] == pytest.approx(100 * (0.5 + 0.016 / 1.6), abs=0.6)
    assert scores["completeness_48mm"] == pytest.approx(100 * (0.5 + 0.048 / 1.6), abs=0.6)
    assert scores["accuracy_32mm"] == 100
    # The far pole is sqrt(2) R from the rim; the reverse direction sees nothing of it.
    assert scores["hausdorff_gt_to_cloud_mm"] == pytest.approx(800 * np.sqrt(2), rel=0.01)
    assert scores["hausdorff_cloud_to_gt_mm"] < 30
    assert scores["hausdorff_symmetric_mm"] == scores["hausdorff_gt_to_cloud_mm"]


def test_strict_threshold_as_in_tanks_and_temples():
    truth, cloud = np.zeros((1, 3)), np.array([[0.048, 0.0, 0.0]])
    scores = distance_scores(*(cKDTree(a).query(b)[0] for a, b in ((cloud, truth), (truth, cloud))), (48.0,))
    assert scores["completeness_48mm"] == 0.0  # 48 mm is not less than 48 mm
    assert distance_scores(np.array([0.0479]), np.array([0.0479]), (48.0,))["completeness_48mm"] == 100.0


def test_scores_are_near_those_of_the_tanks_and_temples_toolbox():
    """Open3D's own functions in the toolbox's order: both clouds averaged in voxels of half the threshold, then compared."""
    import open3d as o3d

    rng = np.random.default_rng(13)
    truth = sphere(30_000, 14)
    cloud = truth[truth[:, 0] > -0.5]
    cloud = cloud + rng.normal(scale=0.02, size=cloud.shape)
    cloud = np.concatenate([cloud, np.array(TARGET) + rng.uniform(-1.3, 1.3, (500, 3))])
    scores = measured(PointCloud(cloud), truth_of(truth), CONFIG)["whole"]
    for t in (48, 80):
        s, g = (
            o3d.geometry.PointCloud(o3d.utility.Vector3dVector(p)).voxel_down_sample(t / 2000)
            for p in (cloud, truth)
        )
        precision = 100 * np.mean(np.asarray(s.compute_point_cloud_distance(g)) < t / 1000)
        recall = 100 * np.mean(np.asarray(g.compute_point_cloud_distance(s)) < t / 1000)
        assert scores[f"completeness_{t}mm"] == pytest.approx(recall, abs=0.5)
        # Voxels count floaters, each alone in its own, for more.
        assert precision < scores[f"accuracy_{t}mm"] < precision + 4.0


def test_observable_part_is_scored_backwards_on_all_surface():
    truth = sphere(20_000, 6)
    observable = truth[:, 2] > TARGET[2]
    scores = measured(PointCloud(truth), truth_of(truth, observable), CONFIG)
    # Points on the hidden half are right, so accuracy stays 100 although they are far from "observable".
    assert scores["observable"]["accuracy_16mm"] == 100
    half = measured(PointCloud(truth[observable]), truth_of(truth, observable), CONFIG)
    assert half["observable"]["completeness_48mm"] == 100
    assert half["whole"]["completeness_48mm"] < 55
    assert half["observable"]["n_gt_samples"] == observable.sum()


def test_sectors_run_counter_clockwise_from_east():
    assert sector_centers_deg(12)[0] == 15.0 and sector_centers_deg(12)[3] == 105.0
    points = np.array([[1, 0.1, 0], [0.1, 1, 0], [-0.1, 1, 0], [-1, -0.1, 0], [1, -0.1, 0]], float)
    assert azimuth_sectors(points, TARGET, 4).tolist() == [0, 0, 1, 2, 3]
    assert azimuth_sectors(points + np.array([5, 7, 0]), (5, 7, 0), 4).tolist() == [0, 0, 1, 2, 3]


def test_a_missing_sector_is_zero_and_an_empty_one_is_none():
    truth = sphere(20_000, 7)
    truth = truth[azimuth_sectors(truth, TARGET, 12) != 5]
    cloud = truth[~np.isin(azimuth_sectors(truth, TARGET, 12), [7, 8, 9])]
    sectors = measured(PointCloud(cloud), truth_of(truth), CONFIG)["whole"]["sector_completeness_48mm"]
    assert sectors[5] is None
    assert sectors[8] < 25 and sectors[7] < 40  # a rim of 48 mm, and the poles where sectors are narrow
    assert [sectors[k] for k in (0, 1, 2, 3, 4, 10, 11)] == [100.0] * 7
    assert share_by_sector(np.array([0, 0]), np.array([1.0, 0.0]), 2) == [50.0, None]


def test_nothing_to_score_is_a_failure_and_not_zero():
    truth = truth_of(sphere(1000, 9))
    with pytest.raises(MissionFailure) as failure:
        measured(PointCloud(np.empty((0, 3))), truth, CONFIG)
    assert failure.value.reason == "empty_cloud"
    far = PointCloud(np.full((10, 3), 5.0))
    with pytest.raises(MissionFailure) as failure:
        measured(far, truth, dataclasses.replace(CONFIG, gt_gate_m=0.05))
    assert failure.value.reason == "empty_cloud"
    with pytest.raises(ValueError, match="observable"):
        measured(far, truth_of(sphere(1000, 9), np.zeros(1000, bool)), CONFIG)


MIDDLE = np.array([0.0, 0.0, 0.8])


def scene(seed=0, tilt_deg=0.0, height_m=0.0):
    """A unit-ish rock (upper sphere) on a noisy ground; returns points and the mask of rock points."""
    rng = np.random.default_rng(seed)
    direction = rng.normal(size=(8000, 3))
    rock = 0.7 * direction / np.linalg.norm(direction, axis=1, keepdims=True) + [0, 0, 0.7]
    ground = np.concatenate([rng.uniform(-1.8, 1.8, (6000, 2)), rng.normal(scale=0.005, size=(6000, 1))], 1)
    ground[:, 2] += np.tan(np.deg2rad(tilt_deg)) * ground[:, 0] + height_m
    points = np.concatenate([rock, ground])
    return points, np.arange(len(points)) < len(rock)


def test_ground_goes_and_rock_stays():
    points, is_rock = scene()
    colors = np.where(is_rock[:, None], 200, 10).astype(np.uint8) * np.ones((1, 3), np.uint8)
    cleaned, report = clean_cloud(PointCloud(points, colors), CONFIG, MIDDLE)
    assert (cleaned.colors[:, 0] == 200).mean() > 0.999
    rock_kept = (cleaned.colors[:, 0] == 200).sum() / is_rock.sum()
    # The sphere's foot within 3 cm of the plane goes too: 0.03 / 1.4 = 2.1 % of its area.
    assert rock_kept == pytest.approx(1 - 0.03 / 1.4, abs=0.03)
    assert cleaned.points_m[:, 2].min() > 0.02
    assert report["input"] == len(points) >= report["crop"] > report["ground"] >= report["outliers"]
    assert report["outliers"] == len(cleaned.points_m)
    assert report["ground_found"] == 1 and report["ground_tilt_deg"] < 1


@pytest.mark.parametrize(("tilt_deg", "height_m"), [(5.0, 0.0), (0.0, 0.1), (-8.0, -0.1)])
def test_plane_is_found_where_it_is(tilt_deg, height_m):
    points, _ = scene(1, tilt_deg, height_m)
    plane = find_ground(points, CONFIG, MIDDLE)
    assert plane is not None
    assert np.rad2deg(np.arccos(plane.normal[2])) == pytest.approx(abs(tilt_deg), abs=0.4)
    assert plane.height_at_m(0, 0) == pytest.approx(height_m, abs=0.01)
    assert plane.height_at_m(1, 0) == pytest.approx(height_m + np.tan(np.deg2rad(tilt_deg)), abs=0.02)


def test_a_steep_facet_is_never_taken_for_the_ground():
    rng = np.random.default_rng(2)
    wall = np.stack([np.full(5000, 0.3), rng.uniform(-1, 1, 5000), rng.uniform(0, 1.5, 5000)], 1)
    assert find_ground(wall, CONFIG, MIDDLE) is None
    _, report = clean_cloud(PointCloud(wall), CONFIG, MIDDLE)
    assert report["ground_found"] == 0 and report["ground"] == 5000
    assert np.isnan(report["ground_tilt_deg"])


def rock_with(extra):
    """A rock of 8 mm spacing above the ground with other points; cleaned with and without the fourth step."""
    direction = np.random.default_rng(11).normal(size=(60_000, 3))
    rock = 0.6 * direction / np.linalg.norm(direction, axis=1, keepdims=True) + [0, 0, 0.9]
    cloud = PointCloud(
        np.concatenate([rock, extra]), np.repeat([[9, 9, 9], [1, 1, 1]], [len(rock), len(extra)], 0)
    )
    off = dataclasses.replace(CONFIG, floater_radius_m=0.0, sor_std_ratio=50.0)
    on = dataclasses.replace(off, floater_radius_m=0.024)
    kept = [clean_cloud(cloud, config, MIDDLE)[0].colors[:, 0] for config in (off, on)]
    return [((c == 9).sum() / len(rock), (c == 1).sum() / len(extra)) for c in kept]


def test_scattered_floaters_go_and_the_rock_stays():
    floaters = np.random.default_rng(12).uniform([-1.3, -1.3, 0.3], [1.3, -0.8, 2.2], (2000, 3))
    assert rock_with(floaters) == [(1.0, 1.0), (1.0, 0.0)]


def test_a_small_clump_far_from_the_rock_goes():
    clump = np.array([1.1, 0.0, 0.9]) + np.random.default_rng(13).normal(scale=0.006, size=(45, 3))
    assert rock_with(clump) == [(1.0, 1.0), (1.0, 0.0)]
    near = clump - [0.42, 0.0, 0.0]  # 8 cm from the rock: perhaps a part of it
    assert rock_with(near)[1] == (1.0, 1.0)
