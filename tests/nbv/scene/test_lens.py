"""The true lens: a point is seen where the formulas put it, and nothing black comes in from outside."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scene_helpers import SMALL_CAMERA

from nbv.config import SensorConfig
from nbv.errors import UserError
from nbv.scene.lens import Lens

W, H, FOCAL = SMALL_CAMERA.width_px, SMALL_CAMERA.height_px, SMALL_CAMERA.focal_px
POINT = np.array([0.41, -0.27])  # normalised coordinates of a ray


def seen_at(point: np.ndarray, **sensor: object) -> np.ndarray:
    """(2,) image point (pixel centres at half-integers) of a white spot around the ray ``point``."""
    lens = Lens(SMALL_CAMERA, SensorConfig(**sensor))
    camera = lens.drawn
    columns = (np.arange(camera.width_px) + 0.5 - camera.width_px / 2) / camera.focal_px - point[0]
    rows = (np.arange(camera.height_px) + 0.5 - camera.height_px / 2) / camera.focal_px - point[1]
    spot = np.exp(-(columns**2 + rows[:, None] ** 2) * (FOCAL / 2.5) ** 2 / 2).astype(np.float32)
    light = lens.see(np.repeat(spot[..., None], 3, axis=2))[..., 0]
    assert light.shape == (H, W)
    i, j = np.indices(light.shape) + 0.5
    return np.array([(light * j).sum(), (light * i).sum()]) / light.sum()


def expected_at(point: np.ndarray, focal: float = FOCAL, k1: float = 0, k2: float = 0) -> np.ndarray:
    r2 = (point**2).sum()
    return np.array([W / 2, H / 2]) + focal * point * (1 + k1 * r2 + k2 * r2**2)


@pytest.mark.parametrize(("k1", "k2"), [(-0.1, 0.0), (0.05, 0.0), (-0.28, 0.07), (0.0, 0.1)])
def test_distortion_displaces_a_point_as_its_formula_says(k1, k2):
    straight, bent = expected_at(POINT), seen_at(POINT, k1=k1, k2=k2)
    assert np.abs(bent - expected_at(POINT, k1=k1, k2=k2)).max() < 0.15  # a spot is not a point
    assert np.abs(bent - straight).max() > 0.2


def test_a_focal_error_scales_about_the_centre():
    assert np.abs(seen_at(POINT, focal_error_percent=2.0) - expected_at(POINT, FOCAL * 1.02)).max() < 0.01
    lens = Lens(SMALL_CAMERA, SensorConfig(focal_error_percent=2.0))
    assert lens.drawn == dataclasses.replace(SMALL_CAMERA, focal_px=FOCAL * 1.02)  # nothing is resampled


def test_a_principal_point_error_shifts_the_picture():
    moved = seen_at(POINT, principal_point_error_px=(7.0, -4.5))
    assert np.abs(moved - expected_at(POINT) - (7.0, -4.5)).max() < 0.01


@pytest.mark.parametrize("sensor", [{"k1": -0.5}, {"k2": -0.4}, {"k1": -0.3, "focal_error_percent": -30.0}])
def test_a_lens_that_folds_the_picture_is_a_user_error(sensor):
    with pytest.raises(UserError, match=r"sensor\.k1=.* fold the picture over") as error:
        Lens(SMALL_CAMERA, SensorConfig(**sensor))
    assert "\n" not in str(error.value)
