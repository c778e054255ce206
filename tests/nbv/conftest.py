"""A ball on the ground: as a scene, and as the renderer shows it in even light, with its true depth in closed form."""

from dataclasses import dataclass

import numpy as np
import pytest
from scene_helpers import CENTRE_M, SMALL_CAMERA, SMALL_GROUND, around, closed_form, make_ball

from nbv.config import CameraConfig, SceneConfig
from nbv.geometry.frames import look_at
from nbv.rocks import Rock
from nbv.scene import build_scene, make_renderer


@pytest.fixture(scope="session")
def ball() -> Rock:
    return make_ball()


@pytest.fixture(scope="session")
def ball_scene(ball, gatetune_home):
    return build_scene(ball, SceneConfig(), SMALL_CAMERA, SMALL_GROUND)


@pytest.fixture(scope="session")
def raycast(ball_scene):
    return make_renderer(ball_scene, "raycast")


@dataclass(frozen=True)
class SyntheticScene:
    images: dict
    poses: dict
    depths: dict  # true depth of the ball, else of the ground
    camera: CameraConfig = SMALL_CAMERA


@pytest.fixture(scope="session")
def scene(ball, gatetune_home):
    light = SceneConfig(ambient=1.0, sun_irradiance=0.0)
    renderer = make_renderer(build_scene(ball, light, SMALL_CAMERA, SMALL_GROUND), "raycast")
    poses = {f"view_{a:03d}.png": look_at(around(a, 25.0), CENTRE_M) for a in (0, 9, 18, 27, 36)}
    return SyntheticScene(
        {name: renderer.rgb(pose) for name, pose in poses.items()},
        poses,
        {name: np.minimum(*closed_form(SMALL_CAMERA, pose)) for name, pose in poses.items()},
    )
