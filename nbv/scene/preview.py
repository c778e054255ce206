"""A contact sheet of a rock, for people."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nbv.cache import Store
from nbv.config import CameraConfig, SceneConfig
from nbv.geometry.frames import look_at, unit_vectors
from nbv.rocks.rock import Rock
from nbv.scene.bake import build_scene
from nbv.scene.view import make_renderer

# azimuth, elevation
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
