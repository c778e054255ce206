"""Depth maps on the CPU: semi-global matching of rectified neighbour pairs."""

from __future__ import annotations

from collections.abc import Mapping

import cv2

from nbv.config import CameraConfig, DenseConfig
from nbv.dense.interface import Floats32, Image
from nbv.dense.stereo import choose_neighbours, estimate_depth
from nbv.types import Floats


class SgbmBackend:
    """OpenCV StereoSGBM on one thread; deterministic."""

    name = "sgbm"

    def depth_maps(
        self,
        images: Mapping[str, Image],
        camera_from_world: Mapping[str, Floats],
        camera: CameraConfig,
        target_m: tuple[float, float, float] | Floats,
        config: DenseConfig,
        surface_m: Floats | None = None,
    ) -> dict[str, Floats32]:
        """See `nbv.dense.interface.DepthBackend`.

        Parameters
        ----------
        images, camera_from_world, camera, target_m, config, surface_m
            As there.
        """
        cv2.setNumThreads(1)
        maps = {}
        poses = {name: camera_from_world[name] for name in sorted(images)}
        grey = {name: cv2.cvtColor(images[name], cv2.COLOR_RGB2GRAY) for name in poses}
        for name in poses:
            chosen = choose_neighbours(name, poses, target_m, config)
            if chosen:
                pairs = [(grey[other], poses[other]) for other in chosen]
                maps[name] = estimate_depth(
                    grey[name], poses[name], pairs, camera, target_m, config, surface_m
                )
        return maps
