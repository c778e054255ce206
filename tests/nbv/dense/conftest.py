"""A textured sphere on a textured ground, rendered in closed form with its true depth."""

from dataclasses import dataclass

import numpy as np
import pytest
from scene_helpers import CENTRE_M, SMALL_CAMERA, around, closed_form, pixel_rays

from nbv.config import CameraConfig
from nbv.geometry.frames import camera_centers_m, look_at

RADIUS_M = 0.6


@dataclass(frozen=True)
class SyntheticScene:
    images: dict
    poses: dict
    depths: dict  # true depth of the sphere, else of the ground
    camera: CameraConfig = SMALL_CAMERA


def texture(points):
    """Grey value 0 to 255 of surface points (N, 3): random plane waves of 5 to 40 cm."""
    rng = np.random.default_rng(0)
    direction = rng.normal(size=(60, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    wave = direction * (2 * np.pi / np.geomspace(0.05, 0.4, 60))[:, None]
    value = np.cos(points @ wave.T + rng.uniform(0, 2 * np.pi, 60)).sum(1) / np.sqrt(30)
    return np.clip(128 + 50 * value, 0, 255)


def render(pose, camera=SMALL_CAMERA):
    """RGB image and true depth from a pose."""
    depth = np.minimum(*closed_form(camera, pose, RADIUS_M))
    rays, hit = pixel_rays(camera) @ pose[:3, :3], np.isfinite(depth)
    grey = np.full(depth.shape, 180.0)
    grey[hit] = texture(camera_centers_m(pose) + rays[hit] * depth[hit, None])
    return np.repeat(np.rint(grey).astype(np.uint8)[..., None], 3, axis=2), depth


@pytest.fixture(scope="session")
def scene():
    poses = {f"view_{a:03d}.png": look_at(around(a, 25.0), CENTRE_M) for a in (0, 9, 18, 27, 36)}
    rendered = {name: render(pose) for name, pose in poses.items()}
    return SyntheticScene(
        {n: image for n, (image, _) in rendered.items()},
        poses,
        {n: depth for n, (_, depth) in rendered.items()},
    )
