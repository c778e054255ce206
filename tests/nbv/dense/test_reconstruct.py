"""From images to one cloud: consistency, fusion, failures."""

import dataclasses

import numpy as np
import pytest

from nbv.config import DenseConfig
from nbv.dense import PosedViews, patchmatch_runs
from nbv.dense.patchmatch import read_depth_maps, write_workspace
from nbv.dense.reconstruct import dense_cloud
from nbv.dense.stereo import points_to_search
from nbv.errors import MissionFailure
from nbv.geometry.frames import look_at

CONFIG = DenseConfig(agreeing_views=3)
TARGET = (0.0, 0.0, 0.8)
RADIUS_M = 0.8


def surface_distance_m(points):
    """Distance to the sphere or the ground, whichever is nearer."""
    to_sphere = np.abs(np.linalg.norm(points - np.array(TARGET), axis=1) - RADIUS_M)
    return np.minimum(to_sphere, np.abs(points[:, 2]))


def cloud_of(scene, config=CONFIG, images=None, poses=None, sparse_points_m=None):
    images, poses = scene.images if images is None else images, scene.poses if poses is None else poses
    return dense_cloud(PosedViews(images, poses, scene.camera, TARGET, config), sparse_points_m)


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


def test_fewer_than_two_usable_views_is_a_failure(scene):
    name = "view_000.png"
    one = {name: scene.images[name]}
    apart = {name: scene.images[name], "far.png": scene.images["view_036.png"]}
    poses = {**scene.poses, "far.png": look_at(np.array([-3.0, 0, 1.5]), np.array(TARGET))}
    for images in ({}, one, apart):
        with pytest.raises(MissionFailure) as failure:
            cloud_of(scene, images=images, poses={n: poses[n] for n in images})
        assert failure.value.reason == "too_few_views"


def test_nothing_confirmed_is_a_failure(scene):
    config = dataclasses.replace(CONFIG, agreeing_views=6)  # there are five views
    with pytest.raises(MissionFailure) as failure:
        cloud_of(scene, config)
    assert failure.value.reason == "empty_dense_cloud"


@pytest.mark.slow
def test_patchmatch_with_cuda_agrees_with_the_closed_form(scene):
    if not patchmatch_runs():
        pytest.skip("needs an NVIDIA GPU and a pycolmap with CUDA: pip install 'gatetune[cuda]'")
    config = dataclasses.replace(CONFIG, backend="patchmatch")
    assert np.median(surface_distance_m(cloud_of(scene, config).points_m)) < 0.01


def test_colmaps_depth_maps_are_read_back(scene, tmp_path):
    import pycolmap

    write_workspace(tmp_path, PosedViews(scene.images, scene.poses, scene.camera, TARGET, CONFIG))
    depth_m = np.full((240, 320), 2.5, np.float32)
    depth_m[3, 4] = 0
    file = tmp_path / "stereo" / "depth_maps" / "view_000.png.photometric.bin"
    pycolmap.DepthMap.from_array(depth_m, 2.0, 3.0).write(file)
    back = read_depth_maps(tmp_path, list(scene.poses))
    assert list(back) == ["view_000.png"]
    np.testing.assert_array_equal(back["view_000.png"], np.where(depth_m > 0, depth_m, np.nan))


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
