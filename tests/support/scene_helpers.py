"""A ball on a small ground: shapes with closed forms, baked in a second."""

import hashlib
from dataclasses import replace

import numpy as np
import trimesh
from numpy.typing import ArrayLike, NDArray

from nbv.config import CameraConfig
from nbv.geometry.frames import camera_centers_m, intrinsic_matrix
from nbv.rocks.rock import Rock, make_rock
from nbv.scene import Scene, make_renderer
from nbv.scene.ground import GroundSpec

BALL_RADIUS_M = 0.8
CENTRE_M = np.array([0.0, 0.0, BALL_RADIUS_M])
SMALL_GROUND = GroundSpec(texel_m=0.012, size_px=1024, levels=3)  # reaches 24.6 m
SMALL_CAMERA = CameraConfig(width_px=320, height_px=240, focal_px=232.87)


def around(azimuths_deg: ArrayLike, elevations_deg: ArrayLike, radius_m: float = 3.5) -> NDArray[np.float64]:
    """(..., 3) about the ball's centre."""
    a, e = np.broadcast_arrays(np.deg2rad(azimuths_deg), np.deg2rad(elevations_deg))
    return CENTRE_M + radius_m * np.stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)], axis=-1)


def pixel_rays(camera: CameraConfig) -> NDArray[np.float64]:
    """(H, W, 3) camera-frame directions with z = 1 through pixel centres at half-integers."""
    v, u = np.indices((camera.height_px, camera.width_px)) + 0.5
    return np.stack([u, v, np.ones_like(u)], axis=-1) @ np.linalg.inv(intrinsic_matrix(camera)).T


def closed_form(
    camera: CameraConfig, camera_from_world: np.ndarray, radius_m: float = BALL_RADIUS_M
) -> tuple[np.ndarray, np.ndarray]:
    """z-depth of the plane z = 0 and of a ball about `CENTRE_M`, inf where missed."""
    origin = camera_centers_m(camera_from_world)
    d = pixel_rays(camera) @ camera_from_world[:3, :3]
    with np.errstate(divide="ignore"):
        ground = np.where(d[..., 2] < 0, -origin[2] / d[..., 2], np.inf)
    a, b = (d * d).sum(-1), d @ (origin - CENTRE_M)
    disc = b * b - a * ((origin - CENTRE_M) @ (origin - CENTRE_M) - radius_m**2)
    return ground, np.where(disc > 0, (-b - np.sqrt(np.maximum(disc, 0))) / a, np.inf)


def make_ball() -> Rock:
    mesh = trimesh.creation.icosphere(subdivisions=6, radius=BALL_RADIUS_M)
    vertices = mesh.vertices + CENTRE_M
    grain = np.random.default_rng(5).normal(0, 0.35, len(vertices))
    for _ in range(2):  # blobs of a few centimetres, which a 4 m camera can see
        grain = grain[mesh.faces].mean(1)[mesh.vertex_faces].mean(1) * 1.8
    albedo = np.clip(0.3 * np.exp(grain), 0.05, 0.7)[:, None].astype(np.float32) * np.ones(3, np.float32)
    ball = make_rock("ball", vertices, mesh.faces, albedo, split="train", difficulty="")
    return replace(ball, sha256=hashlib.sha256(b"ball").hexdigest())


def flagged(scene: Scene) -> Scene:
    """The same shapes in colours that tell them apart: rock red, ground white where x > 0, else black."""
    colours = np.zeros_like(scene.vertex_radiance)
    colours[:, 0] = 1.0
    spec = scene.ground_spec
    east = np.arange(spec.size_px) >= spec.size_px // 2  # columns
    levels = spec.levels * (np.tile(np.where(east, 65535, 0).astype(np.uint16), (spec.size_px, 1)),)
    return replace(scene, vertex_radiance=colours, ground_levels=levels, sky_radiance=0.0)


def rock_in_picture(scene: Scene, pose: np.ndarray) -> NDArray[np.bool_]:
    """(H, W) pixels at least half of which the rock fills."""
    red, green, _ = np.moveaxis(make_renderer(flagged(scene), "raycast").rgb(pose).astype(int), 2, 0)
    return (red > 187) & (green < 188) & (red - green > 40)  # the ground is hardly tinted
