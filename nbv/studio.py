"""Where photographs are taken: the actual position, the gimbal aimed at the target, the sensor's noise."""

from __future__ import annotations

import numpy as np

from nbv.config import MissionConfig
from nbv.frames import look_at
from nbv.rocks import Rock
from nbv.scene import Renderer, photograph
from nbv.types import Capture, Viewpoint


class Studio:
    """Photographs one rock in one replicate."""

    def __init__(self, renderer: Renderer, rock: Rock, replicate: int, config: MissionConfig) -> None:
        self._renderer, self._rock, self._replicate, self._config = renderer, rock, replicate, config

    def take_photograph(self, viewpoint: Viewpoint, position_m: np.ndarray) -> Capture:
        """The photograph of ``viewpoint``, taken from ``position_m`` (3,), the vehicle's actual position."""
        camera_from_world = look_at(position_m, np.asarray(self._config.target_m))
        image = photograph(self._renderer, camera_from_world, self._rock, self._replicate, viewpoint.id,
                           self._config.scene)  # fmt: skip
        return Capture(f"{viewpoint.id}.png", viewpoint, camera_from_world, image)
