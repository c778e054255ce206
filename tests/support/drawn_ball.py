"""A ball on the ground, drawn ray by ray through any lens of COLMAP's, with its mask, its model and its photographs as files."""

import functools
from pathlib import Path

import numpy as np
import pycolmap
from colmap_workspace import model_of
from PIL import Image

from nbv.geometry.frames import look_at

RADIUS_M, DISTANCE_M = 0.8, 4.0
CENTRE_M = np.array([0.0, 0.0, RADIUS_M])
LENSES = {  # of 160 x 120 px
    "PINHOLE": [150.0, 150.0, 82.0, 59.0],
    "SIMPLE_RADIAL": [150.0, 80.0, 60.0, -0.08],
    "OPENCV_FISHEYE": [120.0, 120.0, 80.0, 60.0, 0.02, -0.01, 0.003, -0.001],
}
# EXIF's orientations: the stored picture from the upright one, and what becomes of (right, down) about the middle.
STORED = {
    1: (lambda a: a, [[1, 0], [0, 1]]),
    3: (lambda a: a[::-1, ::-1], [[-1, 0], [0, -1]]),
    6: (lambda a: np.rot90(a, 1), [[0, 1], [-1, 0]]),
    8: (lambda a: np.rot90(a, -1), [[0, -1], [1, 0]]),
}


def positions_m() -> np.ndarray:
    """(14, 3) two rings about the ball."""
    azimuth = np.concatenate([2 * np.pi * np.arange(9) / 9, 2 * np.pi * np.arange(5) / 5])
    elevation = np.deg2rad(np.repeat([20.0, 45.0], [9, 5]))
    across = np.cos(elevation) * [np.cos(azimuth), np.sin(azimuth)]
    return CENTRE_M + DISTANCE_M * np.column_stack([*across, np.sin(elevation)])


def camera(lens: str, scale: float = 1.0) -> pycolmap.Camera:
    made = pycolmap.Camera(model=lens, width=160, height=120, params=LENSES[lens])
    made.rescale(scale)
    return made


@functools.cache
def drawn(lens: str) -> list[tuple[np.ndarray, np.ndarray]]:
    """Picture (120, 160) uint8 and mask (120, 160) from every position."""
    x, y = np.meshgrid(np.arange(160) + 0.5, np.arange(120) + 0.5)
    rays = np.asarray(camera(lens).cam_from_img(np.column_stack([x.ravel(), y.ravel()])))
    answers = []
    for position in positions_m():
        turn = look_at(position, CENTRE_M)[:3, :3]
        sights = np.column_stack([rays, np.ones(len(rays))]) @ turn
        sights /= np.linalg.norm(sights, axis=1, keepdims=True)
        along = -sights @ (position - CENTRE_M)
        square = along**2 - (DISTANCE_M**2 - RADIUS_M**2)
        ball = square > 0
        to_ground = np.where(sights[:, 2] < -1e-3, -position[2] / np.minimum(sights[:, 2], -1e-3), 40.0)
        depth = np.where(ball, along - np.sqrt(np.maximum(square, 0)), np.minimum(to_ground, 40.0))
        shade = texture(position + depth[:, None] * sights)
        answers.append((shade.reshape(120, 160), ball.reshape(120, 160)))
    return answers


def texture(points_m: np.ndarray) -> np.ndarray:
    """(N,) grey of places (N, 3)."""
    waves = np.random.default_rng(0).normal(0, 5, (12, 3))
    return np.clip(128 + 28 * np.sin(points_m @ waves.T + np.arange(12)).sum(axis=1), 0, 255).astype(np.uint8)


def points_m() -> np.ndarray:
    """(N, 3) on the ball and on the ground about it."""
    rng = np.random.default_rng(1)
    ball = rng.normal(size=(1500, 3))
    ball = CENTRE_M + RADIUS_M * ball / np.linalg.norm(ball, axis=1, keepdims=True)
    ground = np.column_stack([rng.uniform(-2.5, 2.5, (1500, 2)), np.zeros(1500)])
    return np.concatenate([ball, ground])


def seen(points: np.ndarray, position: np.ndarray) -> np.ndarray:
    """(N,) which of `points_m` nothing hides from a position."""
    sights = points - position
    length = np.linalg.norm(sights, axis=1)
    along = np.clip((sights * (CENTRE_M - position)).sum(axis=1) / length, 0, length)
    nearest = position + sights / length[:, None] * along[:, None]
    clear = np.linalg.norm(nearest - CENTRE_M, axis=1) >= RADIUS_M
    on_ball = np.abs(np.linalg.norm(points - CENTRE_M, axis=1) - RADIUS_M) < 1e-6
    return np.where(on_ball, (sights * (points - CENTRE_M)).sum(axis=1) < -0.2 * length * RADIUS_M, clear)


def model(lens: str, orientation: int = 1, name: str = "{}.png") -> pycolmap.Reconstruction:
    """COLMAP's model with tracks, of pictures as they are stored with that orientation."""
    turn = np.eye(3)
    turn[:2, :2] = STORED[orientation][1]
    upright = camera(lens)
    middle = np.array([upright.width / 2, upright.height / 2])
    size = np.abs(turn[:2, :2]) @ (2 * middle)
    params = np.array(upright.params)
    principal = list(upright.principal_point_idxs())
    params[principal] = turn[:2, :2] @ (params[principal] - middle) + size / 2
    stored = pycolmap.Camera(model=lens, width=int(size[0]), height=int(size[1]), params=params)
    points, poses, visible, pixels = points_m(), [], [], []
    for position in positions_m():
        pose = look_at(position, CENTRE_M)
        shown = np.asarray(upright.img_from_cam(points @ pose[:3, :3].T + pose[:3, 3]))
        visible.append(seen(points, position) & ((shown > 1) & (shown < 2 * middle - 1)).all(axis=1))
        pixels.append(np.where(visible[-1][:, None], (shown - middle) @ turn[:2, :2].T + size / 2, 0.0))
        poses.append(np.column_stack([turn @ pose[:3, :3], turn @ pose[:3, 3]]))
    names = [name.format(f"view_{index:02d}") for index in range(1, len(poses) + 1)]
    return model_of(stored, names, poses, points, np.array(visible), np.array(pixels))


def write_photographs(folder: Path, lens: str = "PINHOLE", orientation: int = 1) -> Path:
    """``view_01.png`` and so on, stored so that EXIF's orientation turns them upright."""
    folder.mkdir(parents=True, exist_ok=True)
    exif = Image.Exif()
    exif[0x0112] = orientation
    for index, (picture, _) in enumerate(drawn(lens), start=1):
        stored = np.ascontiguousarray(STORED[orientation][0](picture))
        Image.fromarray(stored).convert("RGB").save(folder / f"view_{index:02d}.png", exif=exif)
    return folder
