"""A photograph is kept under all that it depends on."""

from __future__ import annotations

import types

import numpy as np
import pytest

from nbv.cache import Store
from nbv.config import MissionConfig
from nbv.photogrammetric.cached_stages import CachedStudio
from nbv.types import Viewpoint

VIEW = Viewpoint("seed_00", (0.0, -4.0, 1.5), 270.0, 10.0, "seed")
SHAPE = (32, 48, 3)


class CountingRenderer:
    """Grey pictures; ``drawn`` lists the cameras that were asked for."""

    def __init__(self) -> None:
        self.drawn = []

    def rgb(self, camera_from_world):
        return np.full((self.drawn[-1].height_px, self.drawn[-1].width_px, 3), 90, np.uint8)

    def made_for(self, camera):
        self.drawn.append(camera)
        return self


@pytest.mark.parametrize(
    "change",
    [
        {"sensor.exposure_ev": 0.5},
        {"sensor.jpeg_quality": 80},
        {"sensor.focal_error_percent": 0.5},
        {"sensor.k1": -0.05},
        {"scene.sun_elevation_deg": 30.0},
        {"scene.read_noise_dn": 2.0},
    ],
    ids=lambda change: next(iter(change)),
)
def test_another_camera_or_light_takes_another_photograph(tmp_path, change):
    rock = types.SimpleNamespace(sha256="a" * 64)
    ideal = MissionConfig().with_values({"camera.height_px": SHAPE[0], "camera.width_px": SHAPE[1]})
    renderer, images = CountingRenderer(), []
    for config in (ideal, ideal, ideal.with_values(change), ideal.with_values(change)):
        camera = CachedStudio(renderer.made_for, rock, 0, config, Store(tmp_path))
        images.append(camera.take_photograph(VIEW, np.array(VIEW.position_m), 0.0).image)
    assert len(renderer.drawn) == 2
    assert all(image.shape == SHAPE for image in images)
    assert np.array_equal(images[0], images[1])
    assert np.array_equal(images[2], images[3])
