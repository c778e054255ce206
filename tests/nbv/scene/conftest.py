"""A ball, baked once a session."""

import pytest
from scene_helpers import SMALL_CAMERA, SMALL_GROUND, make_ball

from nbv.config import SceneConfig
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
