"""The dense stage: depth maps, consistency, fusion; and which backend makes the depth maps."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from nbv.config import DENSE_BACKENDS
from nbv.dense.fusion import fuse
from nbv.dense.stereo import DenseBackend, PosedViews, check_consistency, points_to_search, sgbm_depth_maps
from nbv.errors import MissionFailure
from nbv.process import give_back_freed_memory
from nbv.types import Floats, PointCloud

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
