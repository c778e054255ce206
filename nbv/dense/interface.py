"""What passes between the dense stages, and the protocol that depth backends implement."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from nbv.config import CameraConfig, DenseConfig
from nbv.types import Floats

Image = NDArray[np.uint8]  # (H, W, 3) RGB
Floats32 = NDArray[np.float32]


class DepthBackend(Protocol):
    """Makes one depth map per view from images with known poses."""

    name: str

    def depth_maps(
        self,
        images: Mapping[str, Image],
        camera_from_world: Mapping[str, Floats],
        camera: CameraConfig,
        target_m: tuple[float, float, float] | Floats,
        config: DenseConfig,
        surface_m: Floats | None = None,
    ) -> dict[str, Floats32]:
        """Depth maps of the views that have at least one usable neighbour, in sorted name order.

        Each is (H, W): metres along the optical axis, NaN where unknown.

        Parameters
        ----------
        images
            RGB images (H, W, 3) by name.
        camera_from_world
            (4, 4) rigid transforms for the same names, metres.
        target_m
            The point that the cameras aim at; depths are sought around it.
        surface_m
            (N, 3) points near which the surface lies, or ``None`` where nothing is known of it. A backend may leave
            out the rest.
        """
        ...
