"""The camera between scene and photograph: each effect as its formula says, and its streams of draws."""

import dataclasses
import math

import cv2
import numpy as np
import pytest
from refusals import refused
from scene_helpers import SMALL_CAMERA

from nbv.config import MissionConfig, SceneConfig, SensorConfig
from nbv.geometry.frames import look_at
from nbv.process import keyed_rng
from nbv.rocks.texture import srgb_from_linear
from nbv.scene import Sensor
from nbv.scene.sensor import Lens, add_sensor_noise, compressed

TARGET = np.array([0.0, 0.0, 0.8])
POSE = look_at(np.array([3.0, -2.0, 2.0]), TARGET)
DISTANCE_M = float(np.linalg.norm(np.array([3.0, -2.0, 2.0]) - TARGET))
GREY = np.full((SMALL_CAMERA.height_px, SMALL_CAMERA.width_px, 3), 100, np.uint8)
QUIET = {"scene.read_noise_dn": 0.0, "scene.shot_noise_dn": 0.0}


def config(**sensor: object) -> MissionConfig:
    small = dataclasses.replace(MissionConfig(), camera=SMALL_CAMERA)
    return small.with_values({f"sensor.{name}": value for name, value in sensor.items()})


def exposed(image: np.ndarray, seed: int = 0, **sensor: object) -> np.ndarray:
    return Sensor(config(**sensor)).exposed(image, POSE, np.random.default_rng(seed))


def linear(image: np.ndarray) -> np.ndarray:
    value = image / 255.0
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)


@pytest.mark.parametrize("value", [20, 128, 230])
def test_standard_deviation_is_as_configured(value):
    config = SceneConfig(read_noise_dn=2.0, shot_noise_dn=3.0)
    grey = np.full((400, 400, 3), value, np.uint8)
    error = add_sensor_noise(grey, config, keyed_rng("sensor noise", "a", 0, "seed_00")).astype(float) - value
    expected = np.sqrt(2.0**2 + 3.0**2 * value / 255 + 1 / 12)  # the last term is rounding
    assert error.std() == pytest.approx(expected, rel=0.01)
    assert abs(error.mean()) < 0.03
    flat = error.reshape(-1, 3)
    assert np.abs(np.corrcoef(flat.T) - np.eye(3)).max() < 0.02  # channels are independent


@pytest.mark.parametrize("stops", [-2.0, -1.0, 1.0])
def test_a_stop_doubles_the_light(stops):
    brighter = exposed(GREY, exposure_ev=stops)
    expected = np.rint(255 * srgb_from_linear(linear(GREY) * 2.0**stops))
    assert np.array_equal(brighter, expected)


@pytest.mark.parametrize("strength", [0.5, 1.0])
def test_light_falls_off_with_the_cosine(strength):
    white = np.full_like(GREY, 255)
    seen = linear(exposed(white, vignetting=strength))
    x, y = (SMALL_CAMERA.width_px - 1) / 2, (SMALL_CAMERA.height_px - 1) / 2  # the corner pixel's centre
    cosine = math.cos(math.atan(math.hypot(x, y) / SMALL_CAMERA.focal_px))
    assert seen[0, 0, 0] == pytest.approx(cosine ** (4 * strength), abs=0.005)
    assert seen[SMALL_CAMERA.height_px // 2, SMALL_CAMERA.width_px // 2].min() > 0.995


def streak_length_px(image: np.ndarray) -> float:
    """Of the picture of a point: a streak of length L has variance L^2 / 12 along it."""
    light = linear(image[..., 0])
    light = light / light.sum()
    rows, columns = np.indices(light.shape)
    centred = np.stack([columns - (light * columns).sum(), rows - (light * rows).sum()]).reshape(2, -1)
    covariance = (centred * light.ravel()) @ centred.T
    return float(np.sqrt(12 * np.linalg.eigvalsh(covariance)[-1]))


@pytest.mark.parametrize("seed", range(2))
def test_a_streak_is_speed_times_time_times_focal_over_depth(seed):
    point = np.zeros_like(GREY)
    point[120, 160] = 255
    speed = {"exposure_time_s": 0.02, "residual_speed_m_s": 8.0}  # long enough to measure on 8 bits
    expected = SMALL_CAMERA.focal_px * 0.02 * 8.0 / DISTANCE_M
    assert expected > 9
    assert streak_length_px(exposed(point, seed, **speed)) == pytest.approx(expected, rel=0.07)
    rate = {"exposure_time_s": 0.02, "residual_rate_deg_s": 120.0}
    expected = SMALL_CAMERA.focal_px * 0.02 * math.radians(120.0)
    assert streak_length_px(exposed(point, seed, **rate)) == pytest.approx(expected, rel=0.07)


def test_noise_is_not_blurred_and_jpeg_comes_last(raycast, ball):
    moving = config(exposure_time_s=0.02, residual_speed_m_s=1.0, jpeg_quality=80)
    loud = Sensor(moving.with_values({"scene.read_noise_dn": 8.0}))
    raw = Sensor(moving.with_values({"scene.read_noise_dn": 8.0, "sensor.jpeg_quality": 0}))
    quiet = Sensor(moving.with_values({**QUIET, "sensor.jpeg_quality": 0}))
    views = [s.photograph(raycast, POSE, (ball.sha256, 0, "seed_00")) for s in (loud, raw, quiet)]
    assert np.array_equal(views[0], compressed(views[1], 80))
    noise = views[1].astype(float) - views[2]
    neighbours = np.corrcoef(noise[:, :-1].ravel(), noise[:, 1:].ravel())[0, 1]
    assert noise.std() == pytest.approx(8.1, rel=0.05)
    assert abs(neighbours) < 0.02
    assert cv2.Laplacian(views[2], cv2.CV_64F).std() < cv2.Laplacian(raycast.rgb(POSE), cv2.CV_64F).std()


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
    refused(r"sensor\.k1=.* fold the picture over", Lens, SMALL_CAMERA, SensorConfig(**sensor))


def test_streams_are_pinned():
    """A change here would silently change every photograph ever taken."""
    drawn = keyed_rng("noise", "0" * 64, 0, "seed_00").integers(0, 2**32, 3)
    assert drawn.tolist() == [1829865842, 3820967078, 1671959790]
