"""Depth against closed forms, light where the sun is, equal bits for equal input."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scene_helpers import BALL_RADIUS_M

from nbv.config import CameraConfig
from nbv.geometry.frames import intrinsic_matrix, invert_rigid, look_at
from nbv.scene import make_renderer

CENTRE = np.array([0.0, 0.0, BALL_RADIUS_M])


def orbit(azimuth_deg: float, elevation_deg: float, radius_m: float = 4.0) -> np.ndarray:
    a, e = np.radians([azimuth_deg, elevation_deg])
    return CENTRE + radius_m * np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])


def pixel_rays(camera: CameraConfig) -> np.ndarray:
    """(H, W, 3) camera-frame directions with z = 1 through pixel centres at half-integers."""
    k = intrinsic_matrix(camera)
    u, v = np.meshgrid(np.arange(camera.width_px) + 0.5, np.arange(camera.height_px) + 0.5)
    return np.stack([(u - k[0, 2]) / k[0, 0], (v - k[1, 2]) / k[1, 1], np.ones_like(u)], axis=-1)


def closed_form(camera: CameraConfig, camera_from_world: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """z-depth of the plane z = 0 and of the ball, inf where missed."""
    world_from_camera = invert_rigid(camera_from_world)
    origin = world_from_camera[:3, 3]
    d = pixel_rays(camera) @ world_from_camera[:3, :3].T
    with np.errstate(divide="ignore"):
        ground = np.where(d[..., 2] < 0, -origin[2] / d[..., 2], np.inf)
    a, b = (d * d).sum(-1), d @ (origin - CENTRE)
    disc = b * b - a * ((origin - CENTRE) @ (origin - CENTRE) - BALL_RADIUS_M**2)
    ball = np.where(disc > 0, (-b - np.sqrt(np.maximum(disc, 0))) / a, np.inf)
    return ground, ball


@settings(max_examples=12)
@given(
    azimuth=st.floats(0, 360),
    elevation=st.floats(3, 85),
    radius=st.floats(2.0, 8.0),
    aside=st.tuples(*[st.floats(-0.6, 0.6)] * 3),
    roll=st.floats(-180, 180),
)
def test_depth_is_the_closed_form(raycast, ball_scene, azimuth, elevation, radius, aside, roll):
    """Any pose, rolled and aimed off the rock: sphere and plane to a millimetre, sky where there is none."""
    pose = look_at(orbit(azimuth, elevation, radius), CENTRE + np.array(aside))
    c, s = np.cos(np.radians(roll)), np.sin(np.radians(roll))
    pose = np.array([[c, -s, 0, 0], [s, c, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]) @ pose
    view = raycast.render(pose)
    ground, ball = closed_form(ball_scene.camera, pose)
    expected = np.minimum(ground, ball)

    assert (
        np.array_equal(np.isinf(view.depth_m), np.isinf(expected))
        or (np.isinf(view.depth_m) ^ np.isinf(expected)).mean() < 0.003
    )  # a pixel row exactly on the horizon, the faceted rim against the sky
    near = np.isfinite(expected) & np.isfinite(view.depth_m) & (expected < 30)
    # The rim of a faceted ball is a little inside the true one: leave out one part in a hundred.
    error = np.abs(view.depth_m[near] - expected[near])
    assert np.percentile(error, 99) < 1e-3
    disagreement = view.rock_mask != (ball < ground)
    assert disagreement.sum() <= 0.02 * max(view.rock_mask.sum(), 200)


def test_a_pixel_looks_through_its_half_integer_centre(raycast, ball_scene):
    """A shift of half a pixel would move the ground under the lowest row by centimetres."""
    pose = look_at(orbit(30, 40), CENTRE)
    depth = raycast.render(pose).depth_m
    ground, _ = closed_form(ball_scene.camera, pose)
    assert abs(depth[-1, 0] - ground[-1, 0]) < 1e-5 * ground[-1, 0]
    assert abs(depth[-2, 0] - ground[-1, 0]) > 5e-3 / 2


def test_rendering_is_bit_for_bit_repeatable(raycast, ball_scene):
    pose = look_at(orbit(200, 25), CENTRE)
    first = raycast.render(pose)
    raycast.render(look_at(orbit(10, 60), CENTRE))
    for again in (raycast.render(pose), make_renderer(ball_scene, "raycast").render(pose)):
        assert np.array_equal(first.rgb, again.rgb)
        assert np.array_equal(first.depth_m, again.depth_m)
        assert np.array_equal(first.rock_mask, again.rock_mask)


@pytest.mark.parametrize("bad", [np.eye(3), np.full((4, 4), np.nan), np.eye(4)])
def test_a_camera_that_cannot_be_is_refused(raycast, bad):
    with pytest.raises(ValueError, match="camera"):
        raycast.render(bad)


def test_the_picture_alone_is_the_picture_of_the_whole_view(raycast):
    for azimuth_deg in (0, 130):
        pose = look_at(orbit(azimuth_deg, 25), CENTRE)
        assert np.array_equal(raycast.rgb(pose), raycast.render(pose).rgb)
