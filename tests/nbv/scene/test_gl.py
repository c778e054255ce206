"""Both backends show the same scene (skipped where there is no EGL)."""

import cv2
import numpy as np
import pytest
from scene_helpers import CENTRE_M

from nbv.errors import UserError
from nbv.geometry.frames import look_at
from nbv.scene import make_renderer

POSES = [
    look_at(np.array(p), CENTRE_M + np.array(off))
    for p, off in [
        ((4.0, 0.0, 1.8), (0.0, 0.0, 0.0)),
        ((-2.0, 2.5, 3.0), (0.1, 0.3, 0.2)),
        ((0.5, -2.0, 4.0), (0.0, 0.0, 0.0)),
    ]
]


@pytest.fixture
def opengl(ball_scene):
    """Skips where there is no OpenGL; one context at a time."""
    try:
        make_renderer(ball_scene, "gl").close()
    except UserError as error:
        pytest.skip(f"no OpenGL on this machine: {error}")


@pytest.mark.parametrize("pose", POSES, ids=["low", "middle", "high"])
def test_backends_agree(raycast, ball_scene, opengl, pose):
    gl = make_renderer(ball_scene, "gl")
    a, b = raycast.rgb(pose), gl.rgb(pose)
    gl.close()
    assert np.abs(a.astype(float) - b).mean() < 5
    assert abs(a.mean() - b.mean()) < 2
    grey_a, grey_b = (cv2.cvtColor(v, cv2.COLOR_RGB2GRAY).astype(np.float32) for v in (a, b))
    window = cv2.createHanningWindow(grey_a.shape[::-1], cv2.CV_32F)
    (dx, dy), _ = cv2.phaseCorrelate(grey_a, grey_b, window)
    assert np.hypot(dx, dy) < 0.15  # half a pixel would be a wrong principal point


def test_an_unknown_backend_is_a_user_error(ball_scene):
    with pytest.raises(UserError, match="raycast, gl"):
        make_renderer(ball_scene, "vulkan")
