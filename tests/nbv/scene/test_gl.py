"""Both backends show the same scene (skipped where there is no EGL)."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from nbv.errors import UserError
from nbv.geometry.frames import look_at
from nbv.scene import make_renderer

CENTRE = np.array([0.0, 0.0, 0.8])
POSES = [
    look_at(np.array(p), CENTRE + np.array(off))
    for p, off in [
        ((4.0, 0.0, 1.8), (0.0, 0.0, 0.0)),
        ((-2.0, 2.5, 3.0), (0.1, 0.3, 0.2)),
        ((0.5, -2.0, 4.0), (0.0, 0.0, 0.0)),
    ]
]


@pytest.fixture(scope="module")
def gl(ball_scene):
    try:
        renderer = make_renderer(ball_scene, "gl")
    except UserError as error:
        pytest.skip(f"no OpenGL on this machine: {error}")
    yield renderer
    renderer.close()


@pytest.mark.parametrize("pose", POSES, ids=["low", "middle", "high"])
def test_backends_agree(raycast, gl, pose):
    a, b = raycast.render(pose), gl.render(pose)
    union = (a.rock_mask | b.rock_mask).sum()
    assert union > 1000
    assert (a.rock_mask & b.rock_mask).sum() / union > 0.98

    both = (a.rock_mask == b.rock_mask) & np.isfinite(a.depth_m) & np.isfinite(b.depth_m) & (a.depth_m < 20)
    relative = np.abs(a.depth_m[both] - b.depth_m[both]) / a.depth_m[both]
    # Multisampled depth is taken up to half a pixel off the centre.
    assert np.median(relative) < 4e-3
    assert np.percentile(relative, 95) < 2e-2
    sky_a, sky_b = np.isinf(a.depth_m), np.isinf(b.depth_m)
    assert (sky_a != sky_b).mean() < 0.01

    assert np.abs(a.rgb.astype(float) - b.rgb).mean() < 5
    assert abs(a.rgb.mean() - b.rgb.mean()) < 2
    grey_a, grey_b = (cv2.cvtColor(v.rgb, cv2.COLOR_RGB2GRAY).astype(np.float32) for v in (a, b))
    window = cv2.createHanningWindow(grey_a.shape[::-1], cv2.CV_32F)
    (dx, dy), _ = cv2.phaseCorrelate(grey_a, grey_b, window)
    assert np.hypot(dx, dy) < 0.15  # half a pixel would be a wrong principal point


def test_an_unknown_backend_is_a_user_error(ball_scene):
    with pytest.raises(UserError, match="raycast, gl"):
        make_renderer(ball_scene, "vulkan")
