"""Folders of photographs of a ball on the ground, as a camera would have left them: JPEG with EXIF."""

import functools
from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image
from scene_helpers import CENTRE_M, SMALL_GROUND, around, make_ball

from nbv.config import CameraConfig, SceneConfig
from nbv.geometry.frames import look_at
from nbv.scene import build_scene, make_renderer

CAMERA = CameraConfig(width_px=480, height_px=360, focal_px=420.0)
FOCAL_35_MM = 30  # of that camera, rounded as EXIF does
ORIGIN_DEG = (46.0, 7.0)
_METRES_PER_DEGREE = 6_378_137.0 * np.pi / 180


MAX_SIZE_PX = 320  # at which the tests import
POSITIONS_M = np.concatenate(
    [around(np.arange(n) * 360 / n, e, 4.0) for n, e in ((14, 20.0), (6, 45.0))]
)  # of the imported set


@functools.cache
def _renderer(seed: int):
    ball = make_ball()
    if seed:
        albedo = np.random.default_rng(seed).permutation(ball.albedo.reshape(-1, 3))
        ball = replace(ball, albedo=albedo, sha256=f"{seed:064d}")
    return make_renderer(
        build_scene(ball, SceneConfig(ground_seed=seed), CAMERA, ground=SMALL_GROUND), "raycast"
    )


def render(position_m: np.ndarray, seed: int = 0) -> Image.Image:
    """The ball, or with another seed another ball on other ground, seen from a place."""
    return Image.fromarray(_renderer(seed).rgb(look_at(position_m, CENTRE_M)))


def save(
    picture: Image.Image, path: Path, index: int = 0, position_m: np.ndarray | None = None, **more
) -> None:
    """A JPEG with EXIF: device, time, focal length and, where a place is given, GPS."""
    exif = picture.getexif()
    exif[0x010F], exif[0x0110] = "Made", more.get("device", "Up")
    exif[0x0112] = more.get("orientation", 1)
    details = exif.get_ifd(0x8769)
    details[0x9003] = f"2026:01:01 12:{index // 60:02d}:{index % 60:02d}"
    details[0xA405] = FOCAL_35_MM
    if position_m is not None:
        gps = exif.get_ifd(0x8825)
        north = ORIGIN_DEG[0] + position_m[1] / _METRES_PER_DEGREE
        east = ORIGIN_DEG[1] + position_m[0] / _METRES_PER_DEGREE / np.cos(np.deg2rad(ORIGIN_DEG[0]))
        gps[1], gps[2], gps[3], gps[4] = "N", _sexagesimal(north), "E", _sexagesimal(east)
        gps[5], gps[6] = b"\x00", float(position_m[2])
    picture.save(path, quality=93, exif=exif)


def _sexagesimal(degrees: float) -> tuple[float, float, float]:
    whole = int(degrees)
    minutes = (degrees - whole) * 60
    return float(whole), float(int(minutes)), (minutes - int(minutes)) * 60


def write_folder(folder: Path, positions_m: np.ndarray, seed: int = 0, prefix: str = "view") -> Path:
    """Photographs from ``positions_m`` (N, 3), ``view_00.jpg`` and so on."""
    folder.mkdir(parents=True, exist_ok=True)
    for index, position in enumerate(positions_m):
        save(render(position, seed), folder / f"{prefix}_{index:02d}.jpg", index, position)
    return folder


def silent(what: str, done: int, total: int) -> None:
    """Says nothing of an import's progress."""
