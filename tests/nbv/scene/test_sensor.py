"""Noise: as strong as configured, and a function of what is photographed."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from nbv.config import SceneConfig
from nbv.geometry.frames import look_at
from nbv.scene import add_sensor_noise, noise_rng, photograph

POSE = look_at(np.array([3.0, -2.0, 2.0]), np.array([0.0, 0.0, 0.8]))


@pytest.mark.parametrize("value", [20, 128, 230])
def test_standard_deviation_is_as_configured(value):
    config = SceneConfig(read_noise_dn=2.0, shot_noise_dn=3.0)
    grey = np.full((400, 400, 3), value, np.uint8)
    error = add_sensor_noise(grey, config, noise_rng("a", 0, "seed_00")).astype(float) - value
    expected = np.sqrt(2.0**2 + 3.0**2 * value / 255 + 1 / 12)  # the last term is rounding
    assert error.std() == pytest.approx(expected, rel=0.01)
    assert abs(error.mean()) < 0.03
    flat = error.reshape(-1, 3)
    assert np.abs(np.corrcoef(flat.T) - np.eye(3)).max() < 0.02  # channels are independent


def test_no_noise_is_no_change():
    image = np.random.default_rng(0).integers(0, 256, (30, 40, 3), dtype=np.uint8)
    config = SceneConfig(read_noise_dn=0.0, shot_noise_dn=0.0)
    assert np.array_equal(add_sensor_noise(image, config, noise_rng("a", 0, "x")), image)


def test_bright_and_dark_do_not_wrap_around():
    config = SceneConfig(read_noise_dn=20.0)
    for value in (0, 255):
        noisy = add_sensor_noise(np.full((50, 50, 3), value, np.uint8), config, noise_rng("a", 0, "x"))
        assert np.abs(noisy.astype(int) - value).max() < 128


def test_a_photograph_depends_on_its_key_alone(raycast, ball):
    config = SceneConfig()
    views = ["seed_00", "cand_017", "seed_03"]
    forwards = {v: photograph(raycast, POSE, ball, 2, v, config) for v in views}
    np.random.seed(1)  # noqa: NPY002  (a global generator must not matter)
    backwards = {v: photograph(raycast, POSE, ball, 2, v, config) for v in reversed(views)}
    for v in views:
        assert np.array_equal(forwards[v], backwards[v])
    assert not np.array_equal(forwards["seed_00"], forwards["seed_03"])
    assert not np.array_equal(forwards["seed_00"], photograph(raycast, POSE, ball, 3, "seed_00", config))
    other = dataclasses.replace(ball, sha256="f" * 64)
    assert not np.array_equal(forwards["seed_00"], photograph(raycast, POSE, other, 2, "seed_00", config))


def test_the_input_is_left_alone(raycast):
    clean = raycast.render(POSE).rgb
    copy = clean.copy()
    add_sensor_noise(clean, SceneConfig(), noise_rng("a", 0, "x"))
    assert np.array_equal(clean, copy)
