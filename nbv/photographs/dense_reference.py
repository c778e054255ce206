"""The dense reference of a set, and how well one half of the photographs agrees with the other."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from nbv.cache import Store, remember
from nbv.config import CameraConfig, DenseConfig
from nbv.dense import PosedViews, make_backend, patchmatch_runs
from nbv.dense.consistency import check_consistency
from nbv.dense.fusion import fuse
from nbv.dense.stereo import points_to_search, sgbm_depth_maps
from nbv.dense.views import shrunk, shrunk_camera
from nbv.errors import MissionFailure, UserError
from nbv.geometry.neighbours import nearest_neighbours
from nbv.memory import give_back_freed_memory
from nbv.photographs.folder import Progress
from nbv.photographs.photograph_set import THRESHOLD_FRACTIONS, HalvesAgreement
from nbv.types import Bools, Floats, PointCloud

MAX_VIEWS = 140  # reconstructed at once: memory grows with them
DENSE_SIZE_PX = 800  # long side: a pixel is then finer than a voxel
WORKERS = 2
MIN_BASELINE_ANGLE_DEG = 60.0  # photographs one behind the other rectify to huge pictures
AGREEING_VIEWS = 3  # as many as `gatetune photographs enough` asks of its missions
VOXEL_M = 0.008


@dataclasses.dataclass(frozen=True)
class View:
    """One registered photograph; its pixels are read when they are needed."""

    name: str
    camera_from_world: Floats  # (4, 4) in the set's frame
    pixels: Callable[[], NDArray[np.uint8]]  # (H, W, 3)
    mask: Callable[[], Bools | None]  # (H, W)
    sha256: str  # of the photograph
    mask_sha256: str


def cloud_of_views(
    views: Sequence[View],
    camera: CameraConfig,
    center_m: Floats,
    half_width_m: float,
    sparse_points_m: Floats,
    store: Store | None,
    progress: Progress,
    what: str,
) -> PointCloud:
    """The dense cloud of some photographs near the object, from the store if it is there.

    More than `MAX_VIEWS` are reconstructed in several interleaved parts, whose clouds are put together.

    Parameters
    ----------
    views
        Photographs with poses.
    camera
        Their pinhole.
    center_m, half_width_m
        The cube in which the object is.
    sparse_points_m
        (N, 3) points of the sparse model; surface is sought near these. Close photographs would else be searched from the
        lens on.
    store
        Where the cloud is kept; nowhere if None.
    progress, what
        Told after every photograph.

    Raises
    ------
    UserError
        Nothing can be reconstructed from them.
    """
    small = shrunk_camera(camera, DENSE_SIZE_PX)
    config = DenseConfig(
        backend="patchmatch" if patchmatch_runs() else "sgbm",
        crop_half_width_m=round(1.15 * half_width_m, 3),
        search="sparse",
        min_baseline_angle_deg=MIN_BASELINE_ANGLE_DEG,
        agreeing_views=AGREEING_VIEWS,
        fusion_voxel_m=VOXEL_M,
    )
    near_m = points_to_search(sparse_points_m, center_m, config)
    parts = -(-len(views) // MAX_VIEWS)
    clouds = []
    for part in range(parts):
        members = views[part::parts]
        said = what if parts == 1 else f"{what}, part {part + 1} of {parts}"
        entry = remember(
            store,
            "photograph-clouds",
            lambda members=members, said=said: _cloud(  # type: ignore[misc]
                members, small, center_m, config, near_m, progress, said
            ),
            code=__name__,
            inputs=[
                [(v.name, v.sha256, v.mask_sha256) for v in members],
                np.array([v.camera_from_world for v in members]),
                camera,
                small,
                config,
                np.asarray(center_m),
                np.zeros((0, 3)) if near_m is None else near_m,
            ],
        )
        clouds.append(PointCloud(**entry))
    if not sum(map(len, clouds)):
        raise UserError(
            "no surface could be reconstructed from the photographs: too few of them overlap, or they show nothing but "
            "plain surfaces; give more photographs of the object"
        )
    return clouds[0] if parts == 1 else _together(clouds)


def distances_to(cloud: PointCloud, points_m: Floats) -> Floats:
    """(N,) from points (N, 3) to the nearest of the cloud."""
    return nearest_neighbours(cloud.points_m, points_m)[0]


def halves_agreement(
    first: PointCloud, second: PointCloud, reference: PointCloud, height_m: float
) -> HalvesAgreement:
    """How completely each half's cloud covers the reference and how well it is confirmed by the other half's.

    Parameters
    ----------
    first, second
        The clouds of the two halves.
    reference
        That of all photographs.
    height_m
        Of the object; thresholds are shares of it.
    """
    limits = [fraction * height_m for fraction in THRESHOLD_FRACTIONS]
    missing = [distances_to(half, reference.points_m) for half in (first, second)]
    wrong = [distances_to(first, second.points_m), distances_to(second, first.points_m)]
    completeness, precision = (
        tuple(float(np.mean([100 * np.mean(d < limit) for d in both])) for limit in limits)
        for both in (missing, wrong)
    )
    scores = tuple(2 * p * r / max(p + r, 1e-9) for p, r in zip(precision, completeness, strict=True))
    return HalvesAgreement(completeness, precision, scores)


def _cloud(
    views: Sequence[View],
    camera: CameraConfig,
    center_m: Floats,
    config: DenseConfig,
    near_m: Floats | None,
    progress: Progress,
    what: str,
) -> dict[str, np.ndarray]:
    size = (camera.width_px, camera.height_px)
    images = {v.name: shrunk(v.pixels(), camera) for v in views}
    poses = {v.name: v.camera_from_world for v in views}
    posed = PosedViews(images, poses, camera, center_m, config, near_m)
    if config.backend == "sgbm":
        maps = sgbm_depth_maps(posed, WORKERS, lambda done: progress(what, done, len(views)))
    else:
        maps = make_backend(config.backend)(posed)
    for view in views:
        if view.name in maps and (mask := view.mask()) is not None:
            inside = cv2.resize(mask.astype(np.uint8), size, interpolation=cv2.INTER_AREA) > 0
            maps[view.name][~inside] = np.nan
    empty: dict[str, np.ndarray] = {
        "points_m": np.zeros((0, 3)),
        "colors": np.zeros((0, 3), np.uint8),
        "normals": np.zeros((0, 3)),
    }
    if not maps:
        return empty
    progress(f"{what}: comparing depths", 0, 1)
    maps = check_consistency(maps, posed)
    progress(f"{what}: fusing", 0, 1)
    try:
        cloud = fuse(maps, posed)
    except MissionFailure:
        return empty
    finally:
        give_back_freed_memory()
    assert cloud.colors is not None and cloud.normals is not None
    return {"points_m": cloud.points_m, "colors": cloud.colors, "normals": cloud.normals}


def _together(clouds: Sequence[PointCloud]) -> PointCloud:
    """The points of several clouds, one a voxel: the first of each."""
    points = np.concatenate([c.points_m for c in clouds])
    _, first = np.unique(np.floor(points / VOXEL_M).astype(np.int64), axis=0, return_index=True)
    first.sort()
    colors = np.concatenate([c.colors for c in clouds if c.colors is not None])
    normals = np.concatenate([c.normals for c in clouds if c.normals is not None])
    return PointCloud(points[first], colors[first], normals[first])
