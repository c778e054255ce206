"""The cache is an optimisation, never a source of different values."""

import dataclasses

import numpy as np
import pytest
from scene_helpers import SMALL_CAMERA, SMALL_GROUND

from nbv.cache import Store
from nbv.config import SceneConfig
from nbv.scene import build_scene


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
