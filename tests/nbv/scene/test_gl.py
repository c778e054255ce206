"""Both backends show the same scene (skipped where there is no EGL)."""

from __future__ import annotations

import os
import subprocess
import sys
import textwrap
from pathlib import Path

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


def test_the_same_renderer_repeats_itself(gl):
    first = gl.render(POSES[0])
    gl.render(POSES[1])
    assert np.array_equal(first.rgb, gl.render(POSES[0]).rgb)


def test_a_camera_below_the_ground_is_refused(gl):
    with pytest.raises(ValueError, match="above the ground"):
        gl.render(np.eye(4))


@pytest.mark.slow
def test_missing_opengl_is_a_user_error_that_names_the_remedy():
    script = textwrap.dedent(
        """
        import sys
        sys.path.insert(0, sys.argv[1])
        from scene_helpers import SMALL_CAMERA, make_ball
        from nbv.config import SceneConfig
        from nbv.errors import UserError
        from nbv.scene import build_scene, make_renderer
        from nbv.scene.ground import GroundSpec
        scene = build_scene(make_ball(), SceneConfig(), SMALL_CAMERA, GroundSpec(0.05, 128, 1))
        try:
            make_renderer(scene, "gl")
        except UserError as error:
            print(error)
        """
    )
    out = subprocess.run(
        [sys.executable, "-c", script, str(Path(__file__).parents[2] / "support")],
        capture_output=True,
        text=True,
        env={**os.environ, "__EGL_VENDOR_LIBRARY_FILENAMES": "/nowhere.json"},
    )
    message = out.stdout.strip().splitlines()
    assert len(message) == 1, out.stdout + out.stderr
    assert "scene.backend=raycast" in message[0]


def test_an_unknown_backend_is_a_user_error(ball_scene):
    with pytest.raises(UserError, match="raycast, gl"):
        make_renderer(ball_scene, "vulkan")
