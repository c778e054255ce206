"""Depth of single views, their agreement and their fusion, against closed forms and rules written out."""

import numpy as np
import pytest
from scene_helpers import around

from nbv.config import CameraConfig, DenseConfig
from nbv.dense import reconstruct
from nbv.dense.reconstruct import fuse
from nbv.dense.stereo import (
    SEARCH_MARGIN_M,
    PosedViews,
    backproject,
    check_consistency,
    depth_normals,
    estimate_depth,
    pixel_matrix,
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


def test_source_views_are_the_nearest_and_neighbours_lie_within_the_angles_best_first():
    poses = {f"v{a:03d}": orbit_pose(a, 0.0) for a in (0, 2, 6, 10, 20, 50, 180)}
    assert posed(poses, DenseConfig(consistency_views=3)).source_views["v010"] == ["v006", "v002", "v000"]
    assert len(posed(poses, DenseConfig(consistency_views=9)).source_views["v010"]) == 6
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


TINY = CameraConfig(width_px=32, height_px=24, focal_px=40.0)
AGREE = DenseConfig(
    agreeing_views=2, consistency_views=3, consistency_relative_depth=0.05, consistency_px=0.35
)
MIDDLE = np.array([0.0, 0.0, 0.8])


def one_pixel(name, row, column, depths, poses):
    """Depths along the pixel's ray in which the views agree, the view's own first."""
    matrix, inverse = pixel_matrix(TINY), np.linalg.inv(pixel_matrix(TINY))
    depth = float(depths[name][row, column])
    world = np.linalg.inv(poses[name]) @ np.append(inverse @ [column, row, 1.0] * depth, 1.0)
    agreed = [depth]
    for other in depths:
        if other == name:
            continue
        seen = (poses[other] @ world)[:3]
        if seen[2] <= 0:
            continue
        x, y = (matrix @ seen)[:2] / seen[2]
        j, i = round(x), round(y)
        if not (0 <= i < TINY.height_px and 0 <= j < TINY.width_px):
            continue
        measured = float(depths[other][i, j])
        if not abs(measured - seen[2]) < AGREE.consistency_relative_depth * seen[2]:
            continue
        back = (poses[name] @ np.linalg.inv(poses[other]) @ np.append(seen * measured / seen[2], 1.0))[:3]
        x, y = (matrix @ back)[:2] / back[2]
        if (x - column) ** 2 + (y - row) ** 2 < AGREE.consistency_px**2:
            agreed.append(float(back[2]))
    return agreed


def test_every_pixel_follows_the_rule():
    """A wall seen from four sides, with noise and holes; some source views see only a part of a view."""
    rng = np.random.default_rng(3)
    poses, depths = {}, {}
    for k, (x, y) in enumerate([(0.0, -3.0), (0.4, -3.0), (-0.5, -2.8), (0.9, -2.2)]):
        name = f"v{k}"
        aim = MIDDLE + np.array([0.5 * (k == 3), 0.0, 0.0])
        poses[name] = look_at(np.array([x, y, 0.9]), aim)
        rays = (
            np.stack([*np.meshgrid(np.arange(32), np.arange(24)), np.ones((24, 32))], axis=-1)
            @ np.linalg.inv(pixel_matrix(TINY)).T
        )
        forward = rays @ poses[name][:3, :3]
        depth = -y / forward[..., 1]  # of the plane y = 0
        depth *= 1 + 0.03 * rng.standard_normal(depth.shape)
        depth[rng.random(depth.shape) < 0.15] = np.nan
        depths[name] = depth.astype(np.float32)
    checked = check_consistency(depths, PosedViews({}, poses, TINY, MIDDLE, AGREE))
    wrong = total = kept = 0
    for name, depth in depths.items():
        for row, column in np.argwhere(np.isfinite(depth)):
            agreed = one_pixel(name, row, column, depths, poses)
            got = checked[name]
            total += 1
            kept += len(agreed) >= AGREE.agreeing_views
            expected = np.mean(agreed) if len(agreed) >= AGREE.agreeing_views else np.nan
            wrong += not np.isclose(got[row, column], expected, rtol=1e-5, equal_nan=True)
        assert np.isnan(checked[name][~np.isfinite(depth)]).all()
    assert 0.3 * total < kept < 0.99 * total
    assert wrong <= 0.002 * total  # a projection half-way between two pixels may round either way


SMALL = CameraConfig(width_px=64, height_px=48, focal_px=60.0)
FUSE = DenseConfig(crop_half_width_m=0.9, fusion_voxel_m=0.05)
ASIDE = (0.1, -0.2, 0.8)


@pytest.fixture
def views():
    """Noisy depth maps with holes; voxels are shared by several views, some points lie beyond the crop."""
    rng = np.random.default_rng(0)
    depths, images, poses = {}, {}, {}
    for k in range(5):
        name = f"v{k}"
        position = np.array([3 * np.cos(k), 3 * np.sin(k), 1.0 + 0.3 * k])
        poses[name] = look_at(position, np.array(ASIDE))
        depth = (3.0 + 0.4 * rng.standard_normal((48, 64))).astype(np.float32)
        depth[:, ::2] = 3.0  # here normals exist
        depth[rng.random((48, 64)) < 0.2] = np.nan
        depths[name] = depth
        images[name] = rng.integers(0, 256, (48, 64, 3), dtype=np.uint8)
    depths["v3"][:] = np.nan  # a view may have nothing to give
    return depths, images, poses


def all_at_once(depths, images, poses):
    """Points, normals and colours of the voxels, each from sums over all its members."""
    members = []
    for name in sorted(depths):
        known = np.isfinite(depths[name])
        rotation = poses[name][:3, :3].astype(np.float32)
        grid = backproject(depths[name], SMALL)
        local, normal = grid[known], depth_normals(grid)[known]
        guess = -1e-3 * local / np.linalg.norm(local, axis=1, keepdims=True)
        normal = np.where(np.isfinite(normal[:, :1]), normal, guess) @ rotation
        world = (local - poses[name][:3, 3].astype(np.float32)) @ rotation
        members.append(np.hstack([world, normal, images[name][known]]))
    every = np.concatenate(members)
    offset = every[:, :3].astype(np.float32) - np.array(ASIDE, np.float32)
    inside = np.abs(offset).max(axis=1) <= FUSE.crop_half_width_m
    cells = np.floor(offset[inside] / np.float32(FUSE.fusion_voxel_m)).astype(int)
    _, of_cell, count = np.unique(cells, axis=0, return_inverse=True, return_counts=True)
    sums = np.column_stack([np.bincount(of_cell.ravel(), column) for column in every[inside].T])
    points, normals, colors = np.split(sums, 3, axis=1)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return points / count[:, None], normals, np.rint(colors / count[:, None])


def fused(depths, images, poses):
    return fuse(depths, PosedViews(images, poses, SMALL, ASIDE, FUSE))


def test_the_cloud_is_the_mean_of_each_voxels_members(views):
    cloud = fused(*views)
    points, normals, colors = all_at_once(*views)
    assert len(points) > 500
    np.testing.assert_allclose(cloud.points_m, points, rtol=0, atol=1e-12)
    np.testing.assert_allclose(cloud.normals, normals, rtol=0, atol=1e-6)  # single-precision products
    np.testing.assert_array_equal(cloud.colors, colors)


@pytest.mark.parametrize("slab_points", [1, 50, 333, 2000])
def test_slabs_do_not_change_a_bit(views, monkeypatch, slab_points):
    whole = fused(*views)
    monkeypatch.setattr(reconstruct, "SLAB_POINTS", slab_points)
    slabs = fused(*views)
    for part in ("points_m", "normals", "colors"):
        np.testing.assert_array_equal(getattr(whole, part), getattr(slabs, part))
