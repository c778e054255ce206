"""Depth maps with COLMAP's PatchMatch stereo, where pycolmap has CUDA."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from pathlib import Path

# isort: off
from nbv.dense.colmap_workspace import read_depth_maps, write_images, write_stereo_sources
import pycolmap
# isort: on

import numpy as np

from nbv.config import CameraConfig, DenseConfig
from nbv.dense.interface import DepthMap, Image
from nbv.dense.stereo import camera_center_m, choose_neighbours
from nbv.errors import UserError
from nbv.types import Floats

_MIN_DEPTH_M = 0.3


class PatchMatchBackend:
    """COLMAP's own stage of the paper; depth maps then go through our consistency check and fusion.

    Not bit-reproducible: COLMAP seeds its CUDA random numbers itself.

    Raises
    ------
    UserError
        The installed pycolmap has no CUDA.
    """

    name = "patchmatch"

    def __init__(self) -> None:
        if not pycolmap.has_cuda:
            raise UserError(
                'dense.backend=patchmatch needs a pycolmap with CUDA: run `pip install "gatetune[cuda]"` on a '
                "machine with an NVIDIA GPU, or set dense.backend=sgbm"
            )

    def depth_maps(
        self,
        images: Mapping[str, Image],
        camera_from_world: Mapping[str, Floats],
        camera: CameraConfig,
        target_m: tuple[float, float, float] | Floats,
        config: DenseConfig,
        surface_m: Floats | None = None,
    ) -> dict[str, DepthMap]:
        """See `nbv.dense.interface.DepthBackend`; every view is matched with ``consistency_views`` others.

        Depths are sought within ``crop_half_width_m`` of the target, as in the SGBM backend without ``surface_m``.
        """
        target = np.asarray(target_m, dtype=float)
        poses = {name: camera_from_world[name] for name in sorted(images)}
        # PatchMatch weighs many sources per pixel, so it is given more than the pairwise matcher.
        wide = DenseConfig(
            neighbours=config.consistency_views,
            min_pair_angle_deg=config.min_pair_angle_deg,
            max_pair_angle_deg=config.max_pair_angle_deg,
            best_pair_angle_deg=config.best_pair_angle_deg,
            min_baseline_angle_deg=config.min_baseline_angle_deg,
        )
        sources = {name: choose_neighbours(name, poses, target, wide) for name in poses}
        sources = {name: chosen for name, chosen in sources.items() if chosen}
        if not sources:
            return {}
        distances = [float(np.linalg.norm(camera_center_m(poses[name]) - target)) for name in sources]
        options = pycolmap.PatchMatchOptions(
            depth_min=max(_MIN_DEPTH_M, min(distances) - config.crop_half_width_m),
            depth_max=max(distances) + config.crop_half_width_m,
            geom_consistency=True,
        )
        with tempfile.TemporaryDirectory(prefix="gatetune-patchmatch-") as folder:
            workspace = Path(folder)
            write_images(workspace, images, poses, camera)
            write_stereo_sources(workspace, sources)
            pycolmap.patch_match_stereo(workspace, options=options)
            return read_depth_maps(workspace, list(sources))
