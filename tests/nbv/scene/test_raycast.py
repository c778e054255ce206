"""What the renderers show: shapes by closed forms, light where the sun is, equal bits for equal input."""

import dataclasses

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scene_helpers import (
    CENTRE_M,
    SMALL_CAMERA,
    SMALL_GROUND,
    around,
    closed_form,
    flagged,
    pixel_rays,
    rock_in_picture,
)

from nbv.cache import Store
from nbv.config import SceneConfig
from nbv.errors import UserError
from nbv.geometry.frames import look_at
from nbv.scene import build_scene, make_renderer


@settings(max_examples=12)
@given(
    azimuth=st.floats(0, 360),
    elevation=st.floats(3, 85),
    radius=st.floats(2.0, 8.0),
    aside=st.tuples(*[st.floats(-0.6, 0.6)] * 3),
    roll=st.floats(-180, 180),
)
def test_rock_and_ground_are_where_the_closed_form_says(ball_scene, azimuth, elevation, radius, aside, roll):
    """Any pose, rolled and aimed off the rock: sphere and plane where each pixel's half-integer centre looks."""
    pose = look_at(around(azimuth, elevation, radius), CENTRE_M + np.array(aside))
    c, s = np.cos(np.radians(roll)), np.sin(np.radians(roll))
    pose = np.array([[c, -s, 0, 0], [s, c, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]) @ pose
    ground, ball = closed_form(ball_scene.camera, pose)

    # The rim of a faceted ball is a little inside the true one.
    disagreement = rock_in_picture(ball_scene, pose) != (ball < ground)
    assert disagreement.sum() <= 0.02 * max((ball < ground).sum(), 200)

    rays = pixel_rays(ball_scene.camera) @ pose[:3, :3]
    east_m = (-pose[:3, :3].T @ pose[:3, 3])[0] + ground * rays[..., 0]
    near = (ground < ball) & (ground < 12) & (np.abs(east_m) > 0.02 * ground)
    white = make_renderer(flagged(ball_scene), "raycast").rgb(pose)[..., 1] > 187
    assert (white[near] == (east_m[near] > 0)).mean() > 0.99


def same(a, b) -> bool:
    return np.array_equal(a.vertex_radiance, b.vertex_radiance) and all(
        np.array_equal(x, y) for x, y in zip(a.ground_levels, b.ground_levels)
    )


@pytest.fixture
def store(tmp_path):
    return Store(tmp_path / "store")


def build(ball, store):
    return build_scene(ball, SceneConfig(), SMALL_CAMERA, SMALL_GROUND, store)


def test_the_second_build_reads_the_cache(ball, ball_scene, store, monkeypatch):
    build(ball, store)

    def no_baking(*_: object) -> None:
        raise AssertionError("baked although the entry is there")

    monkeypatch.setattr("nbv.scene.bake.synthesise_ground", no_baking)
    monkeypatch.setattr("nbv.scene.bake.vertex_radiance", no_baking)
    assert same(build(ball, store), ball_scene)
    for change in ({"ambient": 0.2}, {"sun_irradiance": 0.5}, {"ground_seed": 1}, {"sun_azimuth_deg": 10.0}):
        other = dataclasses.replace(SceneConfig(), **change)
        with pytest.raises(AssertionError, match="baked although"):
            build_scene(ball, other, SMALL_CAMERA, SMALL_GROUND, store)


def test_light_on_a_ball_is_lambert_s(ball, ball_scene):
    """radiance = albedo * (ambient * sky term + sun * max(0, n.l)); a convex body does not shade itself."""
    config = SceneConfig()
    normal = (ball.vertices_m - (0, 0, 0.8)) / 0.8
    to_sun = -np.array(config.sun_direction) / np.linalg.norm(config.sun_direction)
    light = config.ambient * (0.85 + 0.15 * normal[:, 2]) + config.sun_irradiance * np.maximum(
        normal @ to_sun, 0
    )
    clear = np.abs(normal @ to_sun) > 0.05  # at the terminator the facets shade each other
    assert np.allclose(ball_scene.vertex_radiance[clear, 0], (ball.albedo[:, 0] * light)[clear], rtol=0.01)


def test_without_sky_the_rock_s_shadow_is_black(ball):
    """On itself, and on the ground where the ball's shadow falls: the sun stands 30 degrees high in the south."""
    config = SceneConfig(ambient=0.0, sun_elevation_deg=30.0, sun_azimuth_deg=-90.0)
    scene = build_scene(ball, config, SMALL_CAMERA, SMALL_GROUND)
    to_sun = np.array([0.0, -np.cos(np.pi / 6), np.sin(np.pi / 6)])
    facing = ((ball.vertices_m - (0, 0, 0.8)) / 0.8) @ to_sun
    assert (scene.vertex_radiance[facing < -0.02] == 0).all()
    assert (scene.vertex_radiance[facing > 0.1] > 0).all()
    spec = scene.ground_spec
    middle = np.array(
        [0.0, 0.8 / np.tan(np.pi / 6)]
    )  # where the ray through the ball's centre meets the ground
    column, row = np.round((middle + spec.half_extent_m(0)) / spec.texel_m - 0.5).astype(int)
    assert (scene.ground_levels[0][row - 20 : row + 20, column - 20 : column + 20] == 0).all()
    assert scene.ground_levels[0][row, :100].mean() > 1000  # beside it the ground is lit


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
