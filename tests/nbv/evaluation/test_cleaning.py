"""Crop, ground plane, statistical outliers."""

import dataclasses

import numpy as np
import pytest

from nbv.config import EvaluationConfig
from nbv.errors import MissionFailure
from nbv.evaluation.cleaning import clean_cloud, find_ground
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
    cleaned, report = clean_cloud(PointCloud(points, colors), CONFIG, TARGET)
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
    plane = find_ground(points, CONFIG, TARGET)
    assert plane is not None
    assert np.rad2deg(np.arccos(plane.normal[2])) == pytest.approx(abs(tilt_deg), abs=0.4)
    assert plane.height_at_m(0, 0) == pytest.approx(height_m, abs=0.01)
    assert plane.height_at_m(1, 0) == pytest.approx(height_m + np.tan(np.deg2rad(tilt_deg)), abs=0.02)


def test_a_steep_facet_is_never_taken_for_the_ground():
    rng = np.random.default_rng(2)
    wall = np.stack([np.full(5000, 0.3), rng.uniform(-1, 1, 5000), rng.uniform(0, 1.5, 5000)], 1)
    assert find_ground(wall, CONFIG, TARGET) is None
    _, report = clean_cloud(PointCloud(wall), CONFIG, TARGET)
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
    kept = [clean_cloud(cloud, config, TARGET)[0].colors[:, 0] for config in (off, on)]
    return [((c == 9).sum() / len(rock), (c == 1).sum() / len(extra)) for c in kept]


def test_scattered_floaters_go_and_the_rock_stays():
    floaters = np.random.default_rng(12).uniform([-1.3, -1.3, 0.3], [1.3, -0.8, 2.2], (2000, 3))
    assert rock_with(floaters) == [(1.0, 1.0), (1.0, 0.0)]


def test_a_small_clump_far_from_the_rock_goes():
    clump = np.array([1.1, 0.0, 0.9]) + np.random.default_rng(13).normal(scale=0.006, size=(45, 3))
    assert rock_with(clump) == [(1.0, 1.0), (1.0, 0.0)]
    near = clump - [0.42, 0.0, 0.0]  # 8 cm from the rock: perhaps a part of it
    assert rock_with(near)[1] == (1.0, 1.0)


def test_nothing_left_is_a_failure():
    ground = np.concatenate([np.random.default_rng(9).uniform(-1, 1, (500, 2)), np.zeros((500, 1))], 1)
    for points in (np.empty((0, 3)), np.full((50, 3), np.nan), np.full((50, 3), 9.0), ground):
        with pytest.raises(MissionFailure) as failure:
            clean_cloud(PointCloud(points), CONFIG, TARGET)
        assert failure.value.reason == "empty_cloud"
