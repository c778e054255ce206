"""The dense stage: depth maps, consistency, fusion."""

from __future__ import annotations

import time
from collections.abc import Mapping

import numpy as np

from nbv.config import CameraConfig, DenseConfig
from nbv.dense.consistency import check_consistency
from nbv.dense.fusion import fuse
from nbv.dense.interface import DenseReport, DepthBackend, Image
from nbv.errors import MissionFailure, UserError
from nbv.types import Floats, PointCloud


def make_backend(name: str) -> DepthBackend:
    """The depth backend called ``name``.

    Raises
    ------
    UserError
        There is none of that name, or it needs CUDA and this machine or build has none.
    """
    if name == "sgbm":
        from nbv.dense.sgbm import SgbmBackend

        return SgbmBackend()
    if name == "patchmatch":
        from nbv.dense.patchmatch import PatchMatchBackend

        return PatchMatchBackend()
    raise UserError(f"unknown dense backend {name!r}; there are sgbm and patchmatch")


def reconstruct_dense(
    images: Mapping[str, Image],
    camera_from_world: Mapping[str, Floats],
    camera: CameraConfig,
    target_m: tuple[float, float, float] | Floats,
    config: DenseConfig,
    backend: DepthBackend | None = None,
) -> tuple[PointCloud, DenseReport]:
    """Dense point cloud from images with known poses.

    Parameters
    ----------
    images
        RGB images (H, W, 3) uint8 by name. Images without a pose are left out.
    camera_from_world
        (4, 4) rigid transforms by name, metres; poses without an image are left out.
    backend
        Default: the one that ``config.backend`` names.

    Returns
    -------
    cloud, report
        Points in the world frame with colours and normals; timings and pixel counts.

    Raises
    ------
    MissionFailure
        ``too_few_views``: fewer than two views, or no two within the pair angles;
        ``empty_dense_cloud``: nothing is confirmed by enough views.
    UserError
        The backend needs CUDA; an image has another size than the camera.
    """
    names = sorted(set(images) & set(camera_from_world))
    if len(names) < 2:
        raise MissionFailure("too_few_views", f"dense reconstruction needs two posed views, got {len(names)}")
    for name in names:
        if images[name].shape != (camera.height_px, camera.width_px, 3):
            raise UserError(
                f"image {name} has shape {images[name].shape}; the camera is configured for "
                f"{camera.width_px}x{camera.height_px} RGB"
            )
    photos = {name: images[name] for name in names}
    poses = {name: np.asarray(camera_from_world[name], dtype=float) for name in names}
    backend = backend or make_backend(config.backend)

    marks = [time.perf_counter()]
    maps = backend.depth_maps(photos, poses, camera, target_m, config)
    if not maps:
        raise MissionFailure(
            "too_few_views",
            f"no two of {len(names)} views lie {config.min_pair_angle_deg:g} to "
            f"{config.max_pair_angle_deg:g} degrees apart",
        )
    marks.append(time.perf_counter())
    consistent = check_consistency(maps, poses, camera, target_m, config)
    marks.append(time.perf_counter())
    depths = {name: item.depth_m for name, item in consistent.items()}
    cloud = fuse(depths, photos, poses, camera, target_m, config)
    marks.append(time.perf_counter())

    report = DenseReport(
        backend=backend.name,
        n_points=len(cloud.points_m),
        timings_s=dict(zip(("depth", "consistency", "fusion"), np.diff(marks).tolist())),
        views={
            name: {
                "depth_pixels": maps[name].n_valid,
                "consistent_pixels": int(np.isfinite(depths[name]).sum()),
            }
            for name in sorted(maps)
        },
    )
    return cloud, report
