"""Depth in flight: all photographs so far at a quarter of their pixels, for a planner and not for a cloud."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from nbv.dense.consistency import check_consistency
from nbv.dense.stereo import backproject, points_to_search, sgbm_depth_maps
from nbv.dense.views import PosedViews
from nbv.types import Floats, Ints

PARTNERS = 2  # of each photograph
AGREEING_VIEWS = 2
STRIDE_PX = 2  # between the places that are kept, in rows and columns


def coarse_depth(views: PosedViews, sparse_points_m: Floats) -> tuple[Floats, Ints]:
    """Places (K, 3) of the confirmed depths, and by whose depth they are (K,): indices into the names, in the order of the poses.

    Depths are sought near the points (N, 3) of the sparse model.
    """
    size_px = max(views.camera.width_px, views.camera.height_px) // 2
    config = replace(views.config, max_size_px=size_px, neighbours=PARTNERS, agreeing_views=AGREEING_VIEWS)
    surface_m = points_to_search(sparse_points_m, views.target_m, config)
    views = replace(views, config=config, surface_m=surface_m).shrunk()
    names, places, of = list(views.camera_from_world), [np.zeros((0, 3))], [np.zeros(0, dtype=np.int64)]
    for name, depth_m in check_consistency(sgbm_depth_maps(views), views).items():
        points = backproject(depth_m, views.camera)[::STRIDE_PX, ::STRIDE_PX].reshape(-1, 3).astype(float)
        points = points[np.isfinite(points).all(axis=1)]
        pose = views.camera_from_world[name]
        places.append((points - pose[:3, 3]) @ pose[:3, :3])
        of.append(np.full(len(points), names.index(name)))
    return np.concatenate(places), np.concatenate(of)
