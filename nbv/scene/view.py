"""What a renderer returns, how radiance becomes 8-bit grey levels, and a contact sheet of a rock, for people."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from nbv.cache import Store
from nbv.config import RENDERERS, CameraConfig, SceneConfig
from nbv.geometry.frames import camera_centers_m, look_at, unit_vectors
from nbv.rocks.rock import Rock
from nbv.rocks.texture import srgb_from_linear
from nbv.scene.bake import Scene, build_scene
from nbv.types import Floats, Floats32

BUILT_IN = {"raycast": "nbv.scene.raycast:RaycastRenderer", "gl": "nbv.scene.gl:GLRenderer"}


class Renderer(Protocol):
    """All backends have this face and show the same scene."""

    def rgb(self, camera_from_world: Floats) -> NDArray[np.uint8]:
        """Photograph (H, W, 3) of the scene by a camera at ``camera_from_world`` (4, 4), OpenCV axes, before sensor noise.

        Raises ``ValueError`` if the camera is not above the ground.
        """

    def close(self) -> None:
        """Give back what the operating system lent (a GL context); rendering afterwards is a mistake."""


def make_renderer(scene: Scene, backend: str) -> Renderer:
    """The renderer called ``backend``; ``UserError`` if there is none or it cannot run here."""
    renderer: Renderer = RENDERERS.load(backend, BUILT_IN)(scene)
    return renderer


_GREY_LEVELS = np.rint(255 * srgb_from_linear(np.arange(65536) / 65535.0)).astype(np.uint8)


def grey_levels(radiance: Floats32) -> NDArray[np.uint8]:
    """8-bit display values of linear radiance (1.0 is white), by table."""
    index = np.clip(radiance, 0.0, 1.0)
    index *= np.float32(65535.0)
    index += np.float32(0.5)
    return _GREY_LEVELS[index.astype(np.uint16)]


def camera_position(camera_from_world: Floats) -> Floats:
    """(3,) camera centre; ``ValueError`` for a matrix that is not (4, 4) or a camera not above z = 0."""
    matrix = np.asarray(camera_from_world, dtype=float)
    if matrix.shape != (4, 4) or not np.isfinite(matrix).all():
        raise ValueError(f"camera_from_world must be a finite (4, 4) matrix, got shape {matrix.shape}")
    position = camera_centers_m(matrix)
    if position[2] <= 0.0:
        raise ValueError(f"the camera must be above the ground; its z is {position[2]:.3f} m")
    return position


# Of the contact sheet: azimuth, elevation
VIEWS_DEG = ((0.0, 15.0), (60.0, 22.0), (120.0, 36.0), (180.0, 15.0), (240.0, 29.0), (300.0, 55.0))
RADIUS_M = 3.5
COLUMNS, GAP_PX = 3, 4


def preview(rock: Rock, store: Store | None = None) -> NDArray[np.uint8]:
    """(H, W, 3) RGB contact sheet of `VIEWS_DEG`, aimed at the rock's mid height."""
    config = SceneConfig()
    camera = CameraConfig(width_px=320, height_px=240, focal_px=320.0)
    renderer = make_renderer(build_scene(rock, config, camera, store=store), config.backend)
    target = np.array([0.0, 0.0, float(np.max(rock.vertices_m[:, 2])) / 2])
    cells = []
    for outward in unit_vectors(*np.array(VIEWS_DEG).T):
        picture = renderer.rgb(look_at(target + RADIUS_M * outward, target))
        cells.append(np.pad(picture, ((0, GAP_PX), (0, GAP_PX), (0, 0)), constant_values=255))
    renderer.close()
    rows = [np.hstack(cells[start : start + COLUMNS]) for start in range(0, len(cells), COLUMNS)]
    return np.vstack(rows)[:-GAP_PX, :-GAP_PX]
