"""Where photographs are taken: the true pose, the gimbal aimed at the target, the true camera.

The only part of a mission that knows a true pose. What leaves it is a photograph with the pose that telemetry reports.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from nbv.cache import Arrays, Store, cached
from nbv.config import RENDERERS, CameraConfig, MissionConfig
from nbv.flight.telemetry import TelemetryErrors
from nbv.geometry.frames import look_at
from nbv.process import give_back_freed_memory
from nbv.rocks import Rock
from nbv.scene import Renderer, Sensor
from nbv.types import Camera, Capture, Floats, Viewpoint


class SimulatedCamera(Camera):
    """Renders one rock in one replicate.

    The gimbal aims at the target of ``config``, which is the vehicle's. ``store`` keeps photographs, by rock, replicate,
    viewpoint, pose and all of the configuration that they depend on.
    """

    def __init__(
        self,
        make_renderer: Callable[[CameraConfig], Renderer],
        rock: Rock,
        replicate: int,
        config: MissionConfig,
        store: Store | None = None,
    ) -> None:
        super().__init__(config.target_m)
        self._make_renderer = make_renderer
        self._renderer: Renderer | None = None
        self._rock, self._replicate, self._store = rock, replicate, store
        self._world = (
            *(config.camera, config.scene, config.sensor, config.target_m),
            *RENDERERS.sources(config.scene.backend),
        )
        self._sensor = Sensor(config)
        self._errors = TelemetryErrors(
            config.telemetry, rock.sha256, replicate, config.flight.min_camera_altitude_m
        )

    def close(self) -> None:
        """Let the renderer and its scene go (0.15 GB); another photograph would make them again.

        The dense stage, which comes next, decides how much memory a mission takes.
        """
        self._renderer = None
        give_back_freed_memory()

    def take_photograph(self, viewpoint: Viewpoint, position_m: Floats, time_s: float) -> Capture:
        reported = look_at(position_m, np.asarray(self.target_m))
        image = self.photograph(viewpoint, self._errors.true_pose(reported, viewpoint.id, time_s))
        return Capture(f"{viewpoint.id}.png", viewpoint, reported, image)

    def photograph(self, viewpoint: Viewpoint, true_pose: Floats) -> NDArray[np.uint8]:
        """(H, W, 3) what the sensor sees from ``true_pose`` (4, 4)."""
        key = (self._rock.sha256, self._replicate, viewpoint.id)

        def make() -> Arrays:
            if self._renderer is None:
                self._renderer = self._make_renderer(self._sensor.drawn)
            return {"image": self._sensor.photograph(self._renderer, true_pose, key)}

        inputs = [self._rock.sha256, self._replicate, *self._world, viewpoint.id, true_pose]
        return cached(self._store, "photographs", make, code=__name__, inputs=inputs)["image"]
