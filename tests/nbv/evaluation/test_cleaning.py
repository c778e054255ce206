"""Crop, ground plane, statistical outliers."""

import dataclasses

import numpy as np
import pytest

from nbv.config import EvaluationConfig
from nbv.errors import MissionFailure
from nbv.evaluation.cleaning import clean_cloud, find_ground, inlier_mask
from nbv.types import PointCloud

CONFIG = EvaluationConfig()
TARGET = np.array([0.0, 0.0, 0.8])


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
    cleaned, report = clean_cloud(PointCloud(points, colors), CONFIG, TARGET, 0)
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
    plane = find_ground(points, CONFIG, TARGET, 0)
    assert plane is not None
    assert np.rad2deg(np.arccos(plane.normal[2])) == pytest.approx(abs(tilt_deg), abs=0.4)
    assert plane.height_at_m(0, 0) == pytest.approx(height_m, abs=0.01)
    assert plane.height_at_m(1, 0) == pytest.approx(height_m + np.tan(np.deg2rad(tilt_deg)), abs=0.02)


def test_a_steep_facet_is_never_taken_for_the_ground():
    rng = np.random.default_rng(2)
    wall = np.stack([np.full(5000, 0.3), rng.uniform(-1, 1, 5000), rng.uniform(0, 1.5, 5000)], 1)
    assert find_ground(wall, CONFIG, TARGET, 0) is None
    _, report = clean_cloud(PointCloud(wall), CONFIG, TARGET, 0)
    assert report["ground_found"] == 0 and report["ground"] == 5000
    assert np.isnan(report["ground_tilt_deg"])


def test_a_high_flat_top_is_never_taken_for_the_ground():
    rng = np.random.default_rng(3)
    top = np.concatenate([rng.uniform(-0.5, 0.5, (5000, 2)), np.full((5000, 1), 0.9)], 1)
    assert find_ground(top, CONFIG, TARGET, 0) is None


def test_points_below_the_ground_go_with_it():
    points, _ = scene(4)
    below = np.array([[0.1, 0.2, -0.4]]) + np.random.default_rng(0).normal(scale=0.02, size=(500, 3))
    cleaned, _ = clean_cloud(PointCloud(np.concatenate([points, below])), CONFIG, TARGET, 0)
    assert cleaned.points_m[:, 2].min() > 0


def test_same_seed_same_result_whatever_else_is_drawn():
    points, _ = scene(5)
    first, _ = clean_cloud(PointCloud(points), CONFIG, TARGET, 7)
    np.random.default_rng(0).random(1000)
    again, _ = clean_cloud(PointCloud(points), CONFIG, TARGET, 7)
    assert np.array_equal(first.points_m, again.points_m)
    # Another draw moves the refined plane by much less than the removed slab.
    planes = [find_ground(points, CONFIG, TARGET, s) for s in range(5)]
    assert np.ptp([p.height_at_m(0, 0) for p in planes]) < 0.003


def test_statistical_outlier_removal_drops_isolated_points():
    rng = np.random.default_rng(6)
    dense, lone = rng.uniform(-0.5, 0.5, (4000, 3)), rng.uniform(2, 4, (5, 3))
    keep = inlier_mask(np.concatenate([dense, lone]), 20, 2.0)
    assert not keep[-5:].any() and keep[:-5].mean() > 0.95
    assert inlier_mask(dense[:20], 20, 2.0).all()  # not defined on so few points: nothing is dropped


def test_outlier_statistic_by_brute_force():
    points = np.random.default_rng(7).normal(size=(200, 3))
    table = np.sort(np.linalg.norm(points[:, None] - points[None], axis=2), axis=1)[:, 1:21].mean(1)
    assert np.array_equal(inlier_mask(points, 20, 1.0), table <= table.mean() + table.std())


def test_crop_is_a_closed_cube_about_the_target():
    points, _ = scene(8)
    probes = TARGET + np.array([[1.49, 0, 0], [1.51, 0, 0], [0, 0, 1.51]])
    _, report = clean_cloud(PointCloud(np.concatenate([points, probes])), CONFIG, TARGET, 0)
    inside = (np.abs(np.concatenate([points, probes]) - TARGET) <= 1.5).all(1)
    assert report["crop"] == inside.sum() and inside[-3:].tolist() == [True, False, False]


def test_nothing_left_is_a_failure():
    ground = np.concatenate([np.random.default_rng(9).uniform(-1, 1, (500, 2)), np.zeros((500, 1))], 1)
    for points in (np.empty((0, 3)), np.full((50, 3), np.nan), np.full((50, 3), 9.0), ground):
        with pytest.raises(MissionFailure) as failure:
            clean_cloud(PointCloud(points), CONFIG, TARGET, 0)
        assert failure.value.reason == "empty_cloud"


def test_iterations_come_from_the_configuration():
    points, _ = scene(10)
    none = dataclasses.replace(CONFIG, ground_ransac_iterations=0)
    assert find_ground(points, none, TARGET, 0) is None
