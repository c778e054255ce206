"""From images to one cloud: consistency, fusion, failures."""

import dataclasses
import itertools

import numpy as np
import pytest

from nbv.config import CameraConfig, DenseConfig
from nbv.dense import patchmatch_runs
from nbv.dense.consistency import check_consistency, choose_witnesses
from nbv.dense.fusion import fuse
from nbv.dense.patchmatch import read_depth_maps, write_images
from nbv.dense.reconstruct import check_depths, make_backend
from nbv.dense.sgbm import SgbmBackend
from nbv.dense.surface import points_to_search
from nbv.errors import MissionFailure, UserError
from nbv.geometry.frames import look_at

CONFIG = DenseConfig(agreeing_views=3)
TARGET = (0.0, 0.0, 0.8)
RADIUS_M = 0.6


def surface_distance_m(points):
    """Distance to the sphere or the ground, whichever is nearer."""
    to_sphere = np.abs(np.linalg.norm(points - np.array(TARGET), axis=1) - RADIUS_M)
    return np.minimum(to_sphere, np.abs(points[:, 2]))


@pytest.fixture(scope="module")
def maps(scene):
    return SgbmBackend().depth_maps(scene.images, scene.poses, scene.camera, TARGET, CONFIG)


def cloud_of(scene, config=CONFIG, images=None, poses=None, sparse_points_m=None):
    images, poses = scene.images if images is None else images, poses or scene.poses
    return check_depths(images, poses, scene.camera, TARGET, config, sparse_points_m).fuse()


@pytest.fixture(scope="module")
def cloud(scene):
    return cloud_of(scene)


def test_cloud_lies_on_the_true_surface(cloud):
    error = surface_distance_m(cloud.points_m)
    assert len(cloud.points_m) > 5_000
    assert np.median(error) < 0.006
    assert np.mean(error < 0.03) > 0.95


def test_shrunk_photographs_show_the_same_surface(scene, cloud):
    small = cloud_of(scene, dataclasses.replace(CONFIG, max_size_px=240))
    error = surface_distance_m(small.points_m)
    assert 0.4 * len(cloud.points_m) < len(small.points_m) < 0.8 * len(cloud.points_m)  # 9/16 of the pixels
    assert np.median(error) < 0.009 and np.mean(error < 0.04) > 0.95
    assert len(cloud_of(scene, dataclasses.replace(CONFIG, max_size_px=640)).points_m) == len(cloud.points_m)


def test_normals_point_out_of_the_surface(cloud):
    assert np.allclose(np.linalg.norm(cloud.normals, axis=1), 1, atol=1e-6)
    offset = cloud.points_m - np.array(TARGET)
    on_sphere = np.abs(np.linalg.norm(offset, axis=1) - RADIUS_M) < 0.02
    on_sphere &= cloud.points_m[:, 2] > 0.4
    cosine = (cloud.normals * offset)[on_sphere].sum(1) / np.linalg.norm(offset[on_sphere], axis=1)
    assert np.median(cosine) > 0.9


def test_colours_are_the_photographs(scene, cloud):
    assert cloud.colors.dtype == np.uint8 and cloud.colors.shape == cloud.points_m.shape
    # Project the points into the middle view; the sphere's visible side must show the same grey.
    pose, camera = scene.poses["view_018.png"], scene.camera
    local = cloud.points_m @ pose[:3, :3].T + pose[:3, 3]
    pixel = (local[:, :2] / local[:, 2:] * camera.focal_px + [160, 120]).astype(int)
    inside = (pixel >= 0).all(1) & (pixel < [320, 240]).all(1)
    true = scene.depths["view_018.png"][pixel[inside, 1], pixel[inside, 0]]
    visible = np.flatnonzero(inside)[np.abs(true - local[inside, 2]) < 0.03]
    photo = scene.images["view_018.png"][pixel[visible, 1], pixel[visible, 0]].astype(int)
    assert np.median(np.abs(photo - cloud.colors[visible])) < 12


def test_voxels_hold_one_point_each(cloud):
    cells = np.floor((cloud.points_m - np.array(TARGET)) / CONFIG.fusion_voxel_m).astype(int)
    # Means lie within their voxel; float rounding may push a few over an edge.
    assert len(np.unique(cells, axis=0)) > 0.999 * len(cells)


def test_more_agreement_keeps_fewer_and_better_points(scene, maps):
    kept, error = [], []
    for needed in (2, 3, 4, 5):
        config = dataclasses.replace(CONFIG, agreeing_views=needed)
        checked = check_consistency(maps, scene.poses, scene.camera, TARGET, config)
        values = [np.abs(c.depth_m - scene.depths[n])[np.isfinite(c.depth_m)] for n, c in checked.items()]
        kept.append({n: np.isfinite(c.depth_m) for n, c in checked.items()})
        error.append(np.mean(np.concatenate(values) > 0.03))
    for looser, stricter in itertools.pairwise(kept):
        for name in looser:
            assert not (stricter[name] & ~looser[name]).any()
        assert sum(m.sum() for m in stricter.values()) < sum(m.sum() for m in looser.values())
    assert error == sorted(error, reverse=True)


def test_true_depths_confirm_each_other_a_wrong_one_is_dropped(scene):
    truth = {n: np.where(d < 6, d, np.nan).astype(np.float32) for n, d in scene.depths.items()}
    config = dataclasses.replace(CONFIG, agreeing_views=5)
    checked = check_consistency(truth, scene.poses, scene.camera, TARGET, config)
    middle = np.s_[100:140, 140:180]
    assert (checked["view_018.png"].agreeing[middle] == 5).mean() > 0.95
    assert np.abs(checked["view_018.png"].depth_m - scene.depths["view_018.png"])[middle].max() < 0.01
    wrong = truth["view_018.png"].copy()
    wrong[middle] += 0.2
    checked = check_consistency(
        {**truth, "view_018.png": wrong},
        scene.poses,
        scene.camera,
        TARGET,
        dataclasses.replace(CONFIG, agreeing_views=2),
    )
    assert np.isnan(checked["view_018.png"].depth_m[middle]).all()
    assert (checked["view_018.png"].agreeing[middle] == 1).all()


def test_witnesses_are_the_nearest_views(scene):
    assert choose_witnesses("view_000.png", scene.poses, TARGET, 2) == ["view_009.png", "view_018.png"]
    assert len(choose_witnesses("view_000.png", scene.poses, TARGET, 10)) == 4


def test_order_of_views_does_not_matter(scene, cloud):
    backwards = dict(reversed(list(scene.images.items())))
    again = cloud_of(scene, images=backwards)
    assert np.array_equal(cloud.points_m, again.points_m) and np.array_equal(cloud.colors, again.colors)


def test_fewer_than_two_usable_views_is_a_failure(scene):
    name = "view_000.png"
    one = {name: scene.images[name]}
    apart = {name: scene.images[name], "far.png": scene.images["view_036.png"]}
    poses = {**scene.poses, "far.png": look_at(np.array([-3.0, 0, 1.5]), np.array(TARGET))}
    for images in ({}, one, apart):
        with pytest.raises(MissionFailure) as failure:
            cloud_of(scene, images=images, poses=poses)
        assert failure.value.reason == "too_few_views"


def test_nothing_confirmed_is_a_failure(scene):
    config = dataclasses.replace(CONFIG, agreeing_views=6)  # there are five views
    with pytest.raises(MissionFailure) as failure:
        cloud_of(scene, config)
    assert failure.value.reason == "empty_dense_cloud"


def test_fusion_leaves_out_what_is_far_from_the_target():
    camera = CameraConfig(width_px=64, height_px=64, focal_px=30.0)
    pose = look_at(np.array([4.0, 0.0, 0.8]), np.array(TARGET))
    depth = np.full((64, 64), 4.0, np.float32)
    image = np.zeros((64, 64, 3), np.uint8)
    cloud = fuse({"a": depth}, {"a": image}, {"a": pose}, camera, TARGET, CONFIG)
    assert np.abs(cloud.points_m - np.array(TARGET)).max() <= CONFIG.crop_half_width_m
    assert np.allclose(cloud.points_m[:, 0], 0, atol=1e-5)
    assert np.allclose(cloud.normals, [1, 0, 0], atol=1e-3)


def test_wrong_image_size_names_the_image(scene):
    images = {**scene.images, "view_009.png": np.zeros((100, 100, 3), np.uint8)}
    with pytest.raises(UserError, match=r"view_009\.png has shape"):
        cloud_of(scene, images=images)


def test_patchmatch_without_cuda_names_the_remedy():
    import pycolmap

    if pycolmap.has_cuda:
        pytest.skip("pycolmap has CUDA here")
    with pytest.raises(UserError, match=r'pip install "gatetune\[cuda\]"'):
        make_backend("patchmatch")
    with pytest.raises(UserError, match="sgbm, patchmatch"):
        make_backend("magic")


@pytest.mark.slow
def test_patchmatch_with_cuda_agrees_with_the_closed_form(scene):
    if not patchmatch_runs():
        pytest.skip("needs an NVIDIA GPU and a pycolmap with CUDA: pip install 'gatetune[cuda]'")
    config = dataclasses.replace(CONFIG, backend="patchmatch")
    assert np.median(surface_distance_m(cloud_of(scene, config).points_m)) < 0.01


def test_colmaps_depth_maps_are_read_back(scene, tmp_path):
    import pycolmap

    write_images(tmp_path, scene.images, scene.poses, scene.camera)
    depth_m = np.full((240, 320), 2.5, np.float32)
    depth_m[3, 4] = 0
    file = tmp_path / "stereo" / "depth_maps" / "view_000.png.geometric.bin"
    pycolmap.DepthMap.from_array(depth_m, 2.0, 3.0).write(file)
    back = read_depth_maps(tmp_path, list(scene.poses))
    assert list(back) == ["view_000.png"]
    np.testing.assert_array_equal(back["view_000.png"], np.where(depth_m > 0, depth_m, np.nan))


def test_a_search_near_the_sparse_model_finds_the_same_sphere(scene, cloud):
    config = dataclasses.replace(CONFIG, search="sparse")
    with pytest.raises(ValueError, match="sparse model"):
        cloud_of(scene, config)
    on_sphere = cloud.points_m[
        np.abs(np.linalg.norm(cloud.points_m - np.array(TARGET), axis=1) - RADIUS_M) < 0.02
    ]
    stray = np.add(TARGET, [[0.0, 0.0, 1.4]])
    near = cloud_of(scene, config, sparse_points_m=np.concatenate([on_sphere[::20], stray]))
    again = near.points_m[np.abs(np.linalg.norm(near.points_m - np.array(TARGET), axis=1) - RADIUS_M) < 0.02]
    assert 0.97 * len(on_sphere) < len(again) < 1.03 * len(on_sphere)
    assert len(near) < len(cloud)  # less of the ground


def test_what_is_searched_is_the_sparse_model_without_strays():
    rng = np.random.default_rng(0)
    body = np.array(TARGET) + 0.5 * rng.uniform(-1, 1, (2000, 3))
    tip = np.add(TARGET, [[0, 0, z] for z in (0.55, 0.6, 0.64, 0.68, 0.72, 0.76, 0.8)])
    stray = np.add(TARGET, [[0.0, 0.0, 1.4], [1.2, 0.0, 0.0]])
    outside = np.add(TARGET, (0.0, 2.0, 0.0)) + rng.uniform(-0.1, 0.1, (50, 3))
    found = points_to_search(np.concatenate([body, tip, stray, outside]), TARGET, CONFIG)
    assert np.array_equal(found, np.concatenate([body, tip]))
    assert points_to_search(body[:99], TARGET, CONFIG) is None  # too few to say where nothing is
    assert points_to_search(np.zeros((0, 3)), TARGET, CONFIG) is None
