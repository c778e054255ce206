"""Depth of single views against the closed form."""

import cv2
import numpy as np
import pytest
from scene_helpers import around

from nbv.config import CameraConfig, DenseConfig
from nbv.dense.stereo import (
    SEARCH_MARGIN_M,
    PosedViews,
    backproject,
    estimate_depth,
    sgbm_depth_maps,
)
from nbv.geometry.frames import camera_centers_m, look_at

CONFIG = DenseConfig(agreeing_views=3)
TARGET = (0.0, 0.0, 0.8)


def orbit_pose(azimuth_deg, elevation_deg=20.0, radius_m=3.5):
    return look_at(around(azimuth_deg, elevation_deg, radius_m), np.array(TARGET))


def posed(poses, config=CONFIG):
    return PosedViews({}, poses, CameraConfig(), TARGET, config)


def of(scene, surface_m=None):
    return PosedViews(scene.images, scene.poses, scene.camera, TARGET, CONFIG, surface_m)


def test_source_views_are_the_nearest_in_direction():
    poses = {f"v{a:03d}": orbit_pose(a, 0.0) for a in (0, 2, 6, 10, 20, 50, 180)}
    assert posed(poses, DenseConfig(consistency_views=3)).source_views["v010"] == ["v006", "v002", "v000"]
    assert len(posed(poses, DenseConfig(consistency_views=9)).source_views["v010"]) == 6


def test_neighbours_lie_within_the_angles_best_first():
    poses = {f"v{a:03d}": orbit_pose(a, 0.0) for a in (0, 2, 6, 10, 20, 50, 180)}
    assert posed(poses, DenseConfig(neighbours=9)).neighbours["v000"] == ["v010", "v006", "v020"]
    assert posed(poses, DenseConfig(neighbours=2)).neighbours["v000"] == ["v010", "v006"]
    assert posed(poses, DenseConfig()).neighbours["v180"] == []


def test_a_view_in_front_or_behind_is_no_partner_if_configured():
    """Six degrees and a metre: the baseline is 22 degrees off the line to the target."""
    poses = {
        "here": orbit_pose(0, 0.0),
        "behind": orbit_pose(6, 0.0, 4.5),
        "front": orbit_pose(-6, 0.0, 2.5),
        "beside": orbit_pose(14, 0.0),
    }
    behind, beside, _, here = posed(poses).baseline_angles_deg()
    assert behind[3] == here[0] == pytest.approx(25.75 - 3.38, abs=0.01)
    assert beside[3] == pytest.approx(90.0)
    assert posed(poses, DenseConfig()).neighbours["here"] == ["beside", "behind", "front"]
    choosy = DenseConfig(min_baseline_angle_deg=40.0, neighbours=2)
    assert posed(poses, choosy).neighbours["here"] == ["beside"]


@pytest.mark.parametrize(
    ("other", "completeness"),
    # Seen 36 degrees apart, a part of each sphere is hidden or steep in the other image.
    [("view_009.png", 0.9), ("view_018.png", 0.85), ("view_036.png", 0.7)],
)
def test_depth_of_one_pair_matches_the_closed_form(scene, other, completeness):
    # A neighbour on either side, narrow and wide.
    for name, partner in (("view_000.png", other), (other, "view_000.png")):
        depth = estimate_depth(of(scene), name, [partner])
        # On the sphere (the ground runs out of the search range). Errors in pixels of disparity, the
        # matcher's own unit: focal * baseline * |1 / Z - 1 / Z_true|.
        true = scene.depths[name]
        v, u = np.indices(true.shape)
        on_sphere = np.hypot(u - 159.5, v - 119.5) < 35
        baseline = np.linalg.norm(
            camera_centers_m(scene.poses[name]) - camera_centers_m(scene.poses[partner])
        )
        error = (scene.camera.focal_px * baseline * np.abs(1 / depth - 1 / true))[on_sphere]
        known = np.isfinite(error)
        assert known.mean() > completeness, name
        assert np.median(error[known]) < 0.2, name
        assert np.mean(error[known] < 1.0) > 0.95, name


def test_backend_is_deterministic_and_ignores_distant_views(scene):
    first = sgbm_depth_maps(of(scene))
    far = {"zfar.png": orbit_pose(180.0)}
    images = {**scene.images, "zfar.png": np.zeros_like(scene.images["view_000.png"])}
    images = dict(reversed(list(images.items())))
    second = sgbm_depth_maps(PosedViews(images, {**far, **scene.poses}, scene.camera, TARGET, CONFIG), 2)
    assert list(first) == list(second) == sorted(scene.images)
    for name in first:
        assert np.array_equal(first[name], second[name], equal_nan=True)
    assert cv2.getNumThreads() == 1


def near_the_sphere(points_m):
    """Every 40th of the sphere's points that a view sees, as a sparse model might have them."""
    return points_m[np.abs(np.linalg.norm(points_m - np.array(TARGET), axis=1) - 0.8) < 0.01][::40]


def test_searching_near_the_sparse_points_only_finds_the_same(scene):
    name = "view_009.png"
    pose, true = scene.poses[name], scene.depths[name]
    pair = ["view_000.png", "view_018.png"]
    known = np.isfinite(true)
    world = (backproject(true, scene.camera)[known] - pose[:3, 3]) @ pose[:3, :3]
    surface = near_the_sphere(world)
    full = estimate_depth(of(scene), name, pair)
    near = estimate_depth(of(scene, surface), name, pair)
    v, u = np.indices(true.shape)
    on_sphere = np.hypot(u - 159.5, v - 119.5) < 35
    both = np.isfinite(near) & np.isfinite(full) & on_sphere
    assert both.sum() > 0.97 * (np.isfinite(full) & on_sphere).sum()
    assert np.quantile(np.abs(near - full)[both], 0.99) < 0.01
    assert np.isfinite(near).sum() < 0.8 * np.isfinite(full).sum()  # the ground behind and before is left out
    found = np.isfinite(near)
    offset = (backproject(near, scene.camera)[found] - pose[:3, 3]) @ pose[:3, :3] - np.array(TARGET)
    assert np.abs(offset).max() < 0.8 + 2.5 * SEARCH_MARGIN_M


def test_depth_has_no_systematic_offset(scene):
    # A half-pixel mistake in a principal point or a mirrored baseline would show here as centimetres.
    maps = sgbm_depth_maps(of(scene))
    for name, item in maps.items():
        middle = np.s_[90:150, 130:190]  # all sphere
        error = (item - scene.depths[name])[middle]
        assert np.isfinite(error).mean() > 0.9
        assert abs(np.nanmedian(error)) < 0.003, name
