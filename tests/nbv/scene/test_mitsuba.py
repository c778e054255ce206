"""The path-traced backend sees the same geometry under the same light (skipped without the package)."""

from __future__ import annotations

import dataclasses
import importlib
import math

import numpy as np
import pytest
from scene_helpers import PlainRock, make_ball

from nbv.config import CameraConfig, SceneConfig
from nbv.errors import UserError
from nbv.geometry.frames import look_at
from nbv.scene import Scene, build_scene, make_renderer
from nbv.scene.ground import GroundSpec
from nbv.scene.mitsuba import lunar_reflectance
from nbv.terrain import Body, Surroundings, make_relief

CAMERA = CameraConfig(width_px=96, height_px=72, focal_px=70.0)
GROUND = GroundSpec(texel_m=0.04, size_px=256, levels=2)
POSES = [
    look_at(np.array(p), np.array([0.0, 0.0, 0.8])) for p in [(4.0, 0.0, 1.8), (-2, 2.5, 3), (0.5, -2, 4)]
]


def made(rock: PlainRock, **light: object) -> Scene:
    config = dataclasses.replace(SceneConfig(), mitsuba_samples=4, **light)  # type: ignore[arg-type]
    return build_scene(rock, config, CAMERA, GROUND)


def renderer_of(scene: Scene):
    pytest.importorskip("mitsuba", reason="Mitsuba 3 is not installed: pip install 'gatetune[mitsuba]'")
    return make_renderer(scene, "mitsuba")


@pytest.fixture(scope="module")
def ball() -> PlainRock:
    return make_ball()


@pytest.fixture(scope="module")
def scene(ball) -> Scene:
    return made(ball)


@pytest.fixture(scope="module")
def mitsuba(scene):
    return renderer_of(scene)


@pytest.mark.parametrize("pose", POSES, ids=["low", "middle", "high"])
def test_depth_and_mask_are_those_of_the_ray_caster(scene, mitsuba, pose):
    a, b = make_renderer(scene, "raycast").render(pose), mitsuba.render(pose)
    assert (a.rock_mask == b.rock_mask).mean() >= 0.99
    near = np.minimum(a.depth_m, b.depth_m) < 12  # towards the horizon single precision is coarser
    assert (np.abs(a.depth_m[near] - b.depth_m[near]) < 0.01).mean() >= 0.99
    assert (np.isinf(a.depth_m) == np.isinf(b.depth_m)).mean() >= 0.99
    assert abs(a.rgb.mean() - b.rgb.mean()) < 25


def test_relief_and_neighbours_stand_as_the_ray_caster_has_them(ball):
    ground = GroundSpec(texel_m=0.05, size_px=256, levels=1)  # the relief lies in the sharpest level
    neighbour = Body(ball.vertices_m * 0.7 + np.array([1.8, -0.5, 0.0]), ball.faces, ball.albedo)
    around = Surroundings(make_relief(0.15, 1.0, 0), (neighbour,), ("test",))
    config = dataclasses.replace(SceneConfig(), mitsuba_samples=4)
    scene = build_scene(ball, config, CAMERA, ground, surroundings=around)
    a, b = make_renderer(scene, "raycast").render(POSES[0]), renderer_of(scene).render(POSES[0])
    near = a.depth_m < 6
    # The ray caster takes relief at half the picture's resolution, which is coarse here.
    assert (np.abs(a.depth_m[near] - b.depth_m[near]) < 0.015).mean() >= 0.85
    assert (a.rock_mask == b.rock_mask).mean() >= 0.99
    alone = make_renderer(made(ball), "raycast").render(POSES[0])
    assert (np.abs(a.depth_m[near] - alone.depth_m[near]) > 0.05).mean() > 0.2  # there is something to see
    assert a.rock_mask.sum() < 0.95 * alone.rock_mask.sum()  # the neighbour hides part of the rock


def test_equal_input_gives_equal_bits(scene, mitsuba):
    first = mitsuba.rgb(POSES[0])
    mitsuba.rgb(POSES[1])
    assert np.array_equal(first, mitsuba.rgb(POSES[0]))
    assert np.array_equal(first, renderer_of(scene).rgb(POSES[0]))


def test_without_ambient_light_shadows_are_nearly_black(ball):
    """What is left is what the sunlit ground throws at the rock's far side."""
    scene = made(ball, ambient=0.0)
    away = look_at(np.array([0.0, 4.0, 1.0]), np.array([0.0, 0.0, 0.8]))  # the sun stands in the south
    towards = look_at(np.array([0.0, -4.0, 1.0]), np.array([0.0, 0.0, 0.8]))
    renderer = renderer_of(scene)
    dark, bright = renderer.render(away), renderer.render(towards)
    assert np.median(dark.rgb[dark.rock_mask]) < 0.5 * np.median(bright.rgb[bright.rock_mask])
    direct = renderer_of(made(ball, ambient=0.0, mitsuba_depth=2)).render(away)
    shade = direct.rgb[direct.rock_mask]
    assert np.median(shade) == 0


def test_the_sky_is_the_grey_of_the_others(scene, mitsuba):
    level = look_at(np.array([4.0, 0.0, 1.0]), np.array([0.0, 0.0, 3.0]))
    view = mitsuba.render(level)
    assert np.isinf(view.depth_m[0]).all()
    assert np.array_equal(view.rgb[0], make_renderer(scene, "raycast").rgb(level)[0])


def test_a_camera_below_the_ground_is_refused(mitsuba):
    with pytest.raises(ValueError, match="above the ground"):
        mitsuba.render(np.eye(4))


def test_missing_mitsuba_is_one_line_with_the_remedy(scene, monkeypatch):
    real = importlib.import_module

    def missing(name: str, package: str | None = None):
        if name == "mitsuba":
            raise ImportError(name)
        return real(name, package)

    monkeypatch.setattr(importlib, "import_module", missing)
    with pytest.raises(UserError, match=r'pip install "gatetune\[mitsuba\]"') as error:
        make_renderer(scene, "mitsuba")
    assert "\n" not in str(error.value)


def test_the_moon_is_flat_at_opposition_and_dark_from_behind():
    """No limb darkening where a Lambertian ball has it; backward scattering beats forward scattering."""
    cosines = np.cos(np.radians([0.0, 30.0, 60.0]))
    disc = lunar_reflectance(cosines, cosines, 0.0)
    assert disc.max() / disc.min() < 1.6 < cosines[0] / cosines[2]
    side = math.cos(math.radians(60))
    assert lunar_reflectance(side, side, 10.0) > 2 * lunar_reflectance(side, side, 110.0)
    reference = math.cos(math.radians(30))
    assert lunar_reflectance(reference, 1.0, 30.0) == pytest.approx(reference)


def test_samples_and_depth_below_the_least_are_refused():
    with pytest.raises(UserError, match="mitsuba_samples is 0"):
        SceneConfig(mitsuba_samples=0)
    with pytest.raises(UserError, match="mitsuba_depth is 1"):
        SceneConfig(mitsuba_depth=1)
