"""Where photographs are taken: the actual position, the gimbal aimed at the target, the sensor's noise."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from nbv.config import MissionConfig
from nbv.geometry.frames import look_at
from nbv.memory import give_back_freed_memory
from nbv.rocks import Rock
from nbv.scene import Renderer, photograph
from nbv.types import Capture, Floats, Viewpoint


class Studio:
    """Implements ``nbv.types.Camera`` for one rock in one replicate. The renderer is made when the first photograph needs it."""

    def __init__(
        self, make_renderer: Callable[[], Renderer], rock: Rock, replicate: int, config: MissionConfig
    ) -> None:
        self._make_renderer = make_renderer
        self._renderer: Renderer | None = None
        self._rock, self._replicate, self._config = rock, replicate, config

    def close(self) -> None:
        """Let the renderer and its scene go (0.15 GB); another photograph would make them again.

        The dense stage, which comes next, decides how much memory a mission takes.
        """
        self._renderer = None
        give_back_freed_memory()

    def aim(self, position_m: np.ndarray) -> Floats:
        """(4, 4) ``camera_from_world`` of the gimbal camera at ``position_m`` (3,)."""
        return look_at(position_m, np.asarray(self._config.target_m))

    def take_photograph(self, viewpoint: Viewpoint, position_m: np.ndarray) -> Capture:
        """The photograph of ``viewpoint``, taken from ``position_m`` (3,), the vehicle's actual position."""
        if self._renderer is None:
            self._renderer = self._make_renderer()
        pose = self.aim(position_m)
        image = photograph(
            self._renderer, pose, self._rock, self._replicate, viewpoint.id, self._config.scene
        )
        return Capture(f"{viewpoint.id}.png", viewpoint, pose, image)
