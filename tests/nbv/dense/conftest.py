"""A textured sphere on a textured ground, rendered in closed form with its true depth."""

from dataclasses import dataclass

import numpy as np
import pytest

from nbv.config import CameraConfig
from nbv.geometry.frames import intrinsic_matrix, look_at

TARGET = np.array([0.0, 0.0, 0.8])
RADIUS_M = 0.6
CAMERA = CameraConfig(width_px=320, height_px=240, focal_px=232.87)


@dataclass(frozen=True)
class SyntheticScene:
    images: dict
    poses: dict
    depths: dict  # true depth of the sphere, else of the ground
    camera: CameraConfig = CAMERA


def texture(points):
    """Grey value 0 to 255 of surface points (N, 3): random plane waves of 5 to 40 cm."""
    rng = np.random.default_rng(0)
    direction = rng.normal(size=(60, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    wave = direction * (2 * np.pi / np.geomspace(0.05, 0.4, 60))[:, None]
    value = np.cos(points @ wave.T + rng.uniform(0, 2 * np.pi, 60)).sum(1) / np.sqrt(30)
    return np.clip(128 + 50 * value, 0, 255)


def render(pose, camera=CAMERA):
    """RGB image and true depth from a pose."""
    v, u = np.indices((camera.height_px, camera.width_px)) + 0.5
    rays_camera = (
        np.stack([u, v, np.ones_like(u)], -1).reshape(-1, 3) @ np.linalg.inv(intrinsic_matrix(camera)).T
    )
    rays = rays_camera @ pose[:3, :3]  # depth 1 along the optical axis
    center = -pose[:3, :3].T @ pose[:3, 3]
    to_target = center - TARGET
    a, b, c = (rays**2).sum(1), rays @ to_target, to_target @ to_target - RADIUS_M**2
    root = b * b - a * c
    sphere = np.where(root > 0, (-b - np.sqrt(np.maximum(root, 0))) / a, np.inf)
    ground = np.where(rays[:, 2] < -1e-6, -center[2] / np.minimum(rays[:, 2], -1e-6), np.inf)
    depth = np.minimum(sphere, ground)
    grey = np.full(len(rays), 180.0)
    hit = np.isfinite(depth)
    grey[hit] = texture(center + rays[hit] * depth[hit, None])
    shape = (camera.height_px, camera.width_px)
    image = np.repeat(np.rint(grey).astype(np.uint8).reshape(*shape, 1), 3, axis=2)
    return image, depth.reshape(shape)


def orbit(azimuths_deg, elevation_deg=25.0, radius_m=3.5):
    poses = {}
    for azimuth in azimuths_deg:
        a, e = np.deg2rad(azimuth), np.deg2rad(elevation_deg)
        offset = radius_m * np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
        poses[f"view_{azimuth:03d}.png"] = look_at(TARGET + offset, TARGET)
    return poses


@pytest.fixture(scope="session")
def scene():
    poses = orbit((0, 9, 18, 27, 36))
    rendered = {name: render(pose) for name, pose in poses.items()}
    return SyntheticScene(
        {n: image for n, (image, _) in rendered.items()},
        poses,
        {n: depth for n, (_, depth) in rendered.items()},
    )
