"""A contact sheet of a rock, for people."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nbv.cache import Store
from nbv.config import CameraConfig, SceneConfig
from nbv.geometry.frames import look_at
from nbv.scene.bake import RockLike, build_scene
from nbv.scene.factory import make_renderer

PREVIEW_VIEWS_DEG = ((0.0, 15.0), (60.0, 22.0), (120.0, 36.0), (180.0, 15.0), (240.0, 29.0), (300.0, 55.0))
GAP_PX = 4


def preview(
    rock: RockLike,
    config: SceneConfig | None = None,
    *,
    radius_m: float = 3.5,
    views_deg: tuple[tuple[float, float], ...] = PREVIEW_VIEWS_DEG,
    columns: int = 3,
    store: Store | None = None,
) -> NDArray[np.uint8]:
    """(H, W, 3) RGB contact sheet of ``views_deg`` (azimuth, elevation), aimed at the rock's mid height."""
    scene_config = config or SceneConfig()
    camera = CameraConfig(width_px=320, height_px=240, focal_px=320.0)
    renderer = make_renderer(build_scene(rock, scene_config, camera, store=store), scene_config.backend)
    target = np.array([0.0, 0.0, float(np.max(rock.vertices_m[:, 2])) / 2])
    rows = -(-len(views_deg) // columns)
    cell_h, cell_w = camera.height_px + GAP_PX, camera.width_px + GAP_PX
    sheet = np.full((rows * cell_h - GAP_PX, columns * cell_w - GAP_PX, 3), 255, dtype=np.uint8)
    for i, (azimuth, elevation) in enumerate(np.radians(views_deg)):
        outward = np.array(
            [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
        )
        view = renderer.render(look_at(target + radius_m * outward, target))
        top, left = (i // columns) * cell_h, (i % columns) * cell_w
        sheet[top : top + camera.height_px, left : left + camera.width_px] = view.rgb
    renderer.close()
    return sheet
