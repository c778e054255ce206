"""The dense stage: depth maps, consistency, fusion; and which backend makes the depth maps."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nbv.config import DENSE_BACKENDS
from nbv.dense.stereo import (
    DenseBackend,
    DepthMaps,
    PosedViews,
    backproject,
    check_consistency,
    depth_normals,
    points_to_search,
    sgbm_depth_maps,
)
from nbv.errors import MissionFailure
from nbv.geometry.mesh import sums_by_voxel
from nbv.process import give_back_freed_memory
from nbv.types import Floats, Floats32, Ints, PointCloud

BUILT_IN = {"sgbm": sgbm_depth_maps, "patchmatch": "nbv.dense.patchmatch:patchmatch_depth_maps"}
NVIDIA_DRIVER = Path("/dev/nvidiactl")


def patchmatch_runs() -> bool:
    """Whether there is an NVIDIA driver and the installed pycolmap has CUDA; without a driver nothing is loaded."""
    if not NVIDIA_DRIVER.exists():
        return False
    import pycolmap  # noqa: PLC0415  half a second, wasted on most machines

    return bool(pycolmap.has_cuda)


def with_best_dense_stage(values: Mapping[str, Any]) -> dict[str, Any]:
    """``values`` by parameter path with COLMAP's PatchMatch, the paper's, where it runs here and they name no other.

    It becomes part of the configuration, so that a result says what made it, and a resume elsewhere uses the same.
    """
    if "dense.backend" in values or not patchmatch_runs():
        return dict(values)
    return {**values, "dense.backend": "patchmatch"}


def make_backend(name: str) -> DenseBackend:
    """The dense backend called ``name``; `UserError` if there is none."""
    backend: DenseBackend = DENSE_BACKENDS.load(name, BUILT_IN)
    return backend


def dense_cloud(views: PosedViews, sparse_points_m: Floats | None = None) -> PointCloud:
    """The fused cloud of images with known poses: depth maps, checked against each other.

    With ``config.search`` "sparse" depths are sought near the points (N, 3) of the sparse model.

    `MissionFailure` ``too_few_views``: fewer than two views, or no two within the pair angles. ``empty_dense_cloud``: no depth
    is confirmed. `UserError` where the backend needs CUDA.
    """
    config = views.config
    count = len(views.images)
    if count < 2:
        raise MissionFailure("too_few_views", f"dense reconstruction needs two posed views, got {count}")
    views = views.shrunk()
    if config.search == "sparse":
        assert sparse_points_m is not None
        views = replace(views, surface_m=points_to_search(sparse_points_m, views.target_m, config))
    maps = make_backend(config.backend)(views)
    if not maps:
        raise MissionFailure(
            "too_few_views",
            f"no two of {count} views lie {config.min_pair_angle_deg:g} to "
            f"{config.max_pair_angle_deg:g} degrees apart",
        )
    maps = check_consistency(maps, views)
    give_back_freed_memory()  # fusion needs the most of all stages
    return fuse(maps, views)


# From consistent depth maps to one coloured point cloud with normals.


SLAB_POINTS = 400_000  # averaged at once, at about 150 bytes each


def fuse(depth_maps: DepthMaps, views: PosedViews) -> PointCloud:
    """Back-project all depths within ``crop_half_width_m`` of the target along every axis; average what falls into one voxel.

    A normal is the mean over the voxel of the depth maps' normals, or the mean direction to the cameras where there is none.
    `MissionFailure` ``empty_dense_cloud``: no depth at all.
    """
    known = [name for name in sorted(depth_maps) if np.isfinite(depth_maps[name]).any()]
    per_view = [_view_points(name, depth_maps[name], views) for name in known]
    parts = [part for part in per_view if len(part.cells)]
    if not parts:
        agreeing = views.config.agreeing_views
        raise MissionFailure(
            "empty_dense_cloud", f"no depth is confirmed by {agreeing} views near the target"
        )
    # In lexicographic order, slab by slab along the first index, since sums take several times the points' memory.
    low = np.min([part.cells.min(axis=0) for part in parts], axis=0).astype(np.int64)
    extent = np.max([part.cells.max(axis=0) for part in parts], axis=0).astype(np.int64) - low + 1
    per_sheet = sum(
        np.bincount(part.cells[:, 0].astype(np.int64) - low[0], minlength=extent[0]) for part in parts
    )
    slab_of_sheet = np.cumsum(per_sheet) // SLAB_POINTS
    bounds = low[0] + np.append(np.flatnonzero(np.diff(slab_of_sheet, prepend=-1)), extent[0])
    slabs = [
        _average_voxels([part.part(start, stop) for part in parts], low, extent)
        for start, stop in itertools.pairwise(bounds)
    ]
    points, colors, normals = (np.concatenate(values) for values in zip(*slabs, strict=True))
    return PointCloud(points_m=points, colors=colors, normals=normals)


@dataclass(frozen=True)
class _ViewPoints:
    """What one view gives to the cloud: n points near the target, by their voxel's first index."""

    values: Floats32  # (n, 9) point and normal in the world frame, colour; short normals are guesses
    cells: NDArray[np.int16]  # (n, 3) indices of the voxels, from the target; the first column ascends

    def part(self, start: int, stop: int) -> _ViewPoints:
        """Those whose voxel's first index is at least ``start`` and less than ``stop``."""
        rows = slice(*np.searchsorted(self.cells[:, 0], (start, stop)))
        return _ViewPoints(self.values[rows], self.cells[rows])


def _view_points(name: str, depth: Floats32, views: PosedViews) -> _ViewPoints:
    """The points of one depth map (H, W) near the target."""
    camera_from_world, config = views.camera_from_world[name], views.config
    rotation, translation = camera_from_world[:3, :3], camera_from_world[:3, 3]
    rows, columns = np.nonzero(np.isfinite(depth))
    y0, y1, x0, x1 = rows.min(), rows.max() + 1, columns.min(), columns.max() + 1
    local = backproject(depth, views.camera, (y0, y1, x0, x1))
    known = (rows - y0) * (x1 - x0) + (columns - x0)
    normal = depth_normals(local).reshape(-1, 3).take(known, axis=0)
    camera_points = local.reshape(-1, 3).take(known, axis=0)
    world = (camera_points - translation.astype(np.float32)) @ rotation.astype(np.float32)
    offset = world - views.target.astype(np.float32)
    away = np.abs(offset)
    farthest = np.maximum(np.maximum(away[:, 0], away[:, 1]), away[:, 2])
    inside = np.flatnonzero(farthest <= config.crop_half_width_m)
    missing = ~np.isfinite(normal[:, 0])
    # A small weight: only decides where no real normal falls into the voxel.
    fallback = camera_points[missing]
    normal[missing] = -1e-3 * fallback / np.linalg.norm(fallback, axis=1, keepdims=True)
    # Small, as there is a triple for every depth, and sorted in linear time by NumPy.
    most = config.crop_half_width_m / config.fusion_voxel_m + 2
    cell_type = np.int16 if most < np.iinfo(np.int16).max else np.int64
    cells = np.floor(offset.take(inside, axis=0) / np.float32(config.fusion_voxel_m)).astype(cell_type)
    order = np.argsort(cells[:, 0], kind="stable")
    inside = inside[order]
    colors = views.images[name].reshape(-1, 3).take(rows[inside] * depth.shape[1] + columns[inside], axis=0)
    normals = (normal @ rotation.astype(np.float32)).take(inside, axis=0)
    values = np.hstack([world.take(inside, axis=0), normals, colors.astype(np.float32)])
    return _ViewPoints(values, cells.take(order, axis=0))


def _average_voxels(
    parts: list[_ViewPoints], low: Ints, extent: Ints
) -> tuple[Floats, NDArray[np.uint8], Floats]:
    """Points (V, 3), colours (V, 3) and unit normals (V, 3) of the V occupied voxels of some views' points."""
    cell = np.concatenate([part.cells for part in parts]) - low
    key = (cell[:, 0] * extent[1] + cell[:, 1]) * extent[2] + cell[:, 2]
    sums, counts = sums_by_voxel(key, np.concatenate([part.values for part in parts]))
    point, normal, color = np.split(sums, 3, axis=1)
    length, count = np.linalg.norm(normal, axis=1, keepdims=True), counts[:, None]
    return point / count, np.rint(color / count).astype(np.uint8), normal / np.maximum(length, 1e-12)
