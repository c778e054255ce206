"""Shapes against closed forms, light where the sun is, equal bits for equal input."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scene_helpers import CENTRE_M, around, closed_form, flagged, pixel_rays, rock_in_picture

from nbv.config import SceneConfig
from nbv.geometry.frames import look_at
from nbv.scene import make_renderer


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


def test_rendering_is_bit_for_bit_repeatable(raycast, ball_scene):
    pose = look_at(around(200, 25, 4.0), CENTRE_M)
    first = raycast.rgb(pose)
    raycast.rgb(look_at(around(10, 60, 4.0), CENTRE_M))
    for again in (raycast.rgb(pose), make_renderer(ball_scene, "raycast").rgb(pose)):
        assert np.array_equal(first, again)


def test_sky_is_uniform_and_as_configured(raycast):
    picture = raycast.rgb(look_at(np.array([3.0, 0.0, 2.0]), np.array([-3.0, 0.0, 6.0])))
    assert len(np.unique(picture)) == 1
    assert picture[0, 0, 0] == pytest.approx(255 * SceneConfig().sky_grey, abs=0.51)


@pytest.mark.parametrize("bad", [np.eye(3), np.full((4, 4), np.nan), np.eye(4)])
def test_a_camera_that_cannot_be_is_refused(raycast, bad):
    with pytest.raises(ValueError, match="camera"):
        raycast.rgb(bad)
