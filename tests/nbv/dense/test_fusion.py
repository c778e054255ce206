"""Fusion in slabs: the cloud is the one of all points averaged at once, for less memory."""

import numpy as np
import pytest

from nbv.config import CameraConfig, DenseConfig
from nbv.dense import fusion
from nbv.dense.fusion import fuse
from nbv.dense.stereo import PosedViews, backproject, depth_normals
from nbv.geometry.frames import look_at

CAMERA = CameraConfig(width_px=64, height_px=48, focal_px=60.0)
CONFIG = DenseConfig(crop_half_width_m=0.9, fusion_voxel_m=0.05)
TARGET = (0.1, -0.2, 0.8)


@pytest.fixture
def views():
    """Noisy depth maps with holes; voxels are shared by several views, some points lie beyond the crop."""
    rng = np.random.default_rng(0)
    depths, images, poses = {}, {}, {}
    for k in range(5):
        name = f"v{k}"
        position = np.array([3 * np.cos(k), 3 * np.sin(k), 1.0 + 0.3 * k])
        poses[name] = look_at(position, np.array(TARGET))
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
        grid = backproject(depths[name], CAMERA)
        local, normal = grid[known], depth_normals(grid)[known]
        guess = -1e-3 * local / np.linalg.norm(local, axis=1, keepdims=True)
        normal = np.where(np.isfinite(normal[:, :1]), normal, guess) @ rotation
        world = (local - poses[name][:3, 3].astype(np.float32)) @ rotation
        members.append(np.hstack([world, normal, images[name][known]]))
    every = np.concatenate(members)
    offset = every[:, :3].astype(np.float32) - np.array(TARGET, np.float32)
    inside = np.abs(offset).max(axis=1) <= CONFIG.crop_half_width_m
    cells = np.floor(offset[inside] / np.float32(CONFIG.fusion_voxel_m)).astype(int)
    _, of_cell, count = np.unique(cells, axis=0, return_inverse=True, return_counts=True)
    sums = np.column_stack([np.bincount(of_cell.ravel(), column) for column in every[inside].T])
    points, normals, colors = np.split(sums, 3, axis=1)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return points / count[:, None], normals, np.rint(colors / count[:, None])


def fused(depths, images, poses):
    return fuse(depths, PosedViews(images, poses, CAMERA, TARGET, CONFIG))


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
    monkeypatch.setattr(fusion, "SLAB_POINTS", slab_points)
    slabs = fused(*views)
    for part in ("points_m", "normals", "colors"):
        np.testing.assert_array_equal(getattr(whole, part), getattr(slabs, part))
