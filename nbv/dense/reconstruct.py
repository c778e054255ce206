"""The dense stage: depth maps, consistency, fusion."""

from __future__ import annotations

from collections.abc import Mapping

import cv2
import numpy as np

from nbv.config import DENSE_BACKENDS, CameraConfig, DenseConfig
from nbv.dense.consistency import check_consistency
from nbv.dense.fusion import fuse
from nbv.dense.interface import DepthBackend, Image
from nbv.dense.surface import points_to_search
from nbv.errors import MissionFailure, UserError
from nbv.memory import give_back_freed_memory
from nbv.types import Floats, PointCloud


def make_backend(name: str) -> DepthBackend:
    """The depth backend called ``name``; the names stand in `nbv.config.registry`.

    Raises
    ------
    UserError
        There is none of that name, or it needs CUDA and this machine or build has none.
    """
    backend: DepthBackend = DENSE_BACKENDS.load(name)()
    return backend


def shrunk_camera(camera: CameraConfig, max_size_px: int) -> CameraConfig:
    """The camera of photographs whose long side is at most ``max_size_px``; 0: the camera itself."""
    size_px = max(camera.width_px, camera.height_px)
    if not 0 < max_size_px < size_px:
        return camera
    width_px, height_px = (
        round(side * max_size_px / size_px) for side in (camera.width_px, camera.height_px)
    )
    return CameraConfig(width_px, height_px, camera.focal_px * width_px / camera.width_px)


def shrunk(image: Image, camera: CameraConfig) -> Image:
    """The photograph (H, W, 3) at the size of ``camera``; the photograph itself where it has it."""
    size = (camera.width_px, camera.height_px)
    if (image.shape[1], image.shape[0]) == size:
        return image
    return cv2.resize(image, size, interpolation=cv2.INTER_AREA).astype(np.uint8, copy=False)


def dense_cloud(
    images: Mapping[str, Image],
    camera_from_world: Mapping[str, Floats],
    camera: CameraConfig,
    target_m: tuple[float, float, float] | Floats,
    config: DenseConfig,
    sparse_points_m: Floats | None = None,
) -> PointCloud:
    """The fused cloud of images with known poses: depth maps, checked against each other.

    Parameters
    ----------
    images
        RGB images (H, W, 3) uint8 by name. Images without a pose are left out.
    camera_from_world
        (4, 4) rigid transforms by name, metres; poses without an image are left out.
    sparse_points_m
        (N, 3) points of the sparse model, world frame; with ``config.search`` "sparse" depths are sought near these.

    Raises
    ------
    MissionFailure
        ``too_few_views``: fewer than two views, or no two within the pair angles. ``empty_dense_cloud``: no depth is
        confirmed.
    UserError
        The backend needs CUDA; an image has another size than the camera.
    ValueError
        ``config.search`` is "sparse" and there are no ``sparse_points_m``.
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
    camera = shrunk_camera(camera, config.max_size_px)
    photos = {name: shrunk(images[name], camera) for name in names}
    poses = {name: np.asarray(camera_from_world[name], dtype=float) for name in names}
    surface_m = None
    if config.search == "sparse":
        if sparse_points_m is None:
            raise ValueError('dense.search "sparse" needs the points of the sparse model')
        surface_m = points_to_search(sparse_points_m, target_m, config)
    maps = make_backend(config.backend).depth_maps(photos, poses, camera, target_m, config, surface_m)
    if not maps:
        raise MissionFailure(
            "too_few_views",
            f"no two of {len(names)} views lie {config.min_pair_angle_deg:g} to "
            f"{config.max_pair_angle_deg:g} degrees apart",
        )
    maps = check_consistency(maps, poses, camera, target_m, config)
    give_back_freed_memory()  # fusion needs the most of all stages
    return fuse(maps, photos, poses, camera, target_m, config)
