"""Features of the ground as seen from above: what holds photographs together that look from far apart.

SIFT matches little between views 30 degrees and more apart (Mikolajczyk and Schmid, "A Performance Evaluation of Local
Descriptors", PAMI 2005). But telemetry says where the level ground z = 0 lies in a photograph: drawn from straight above,
all photographs show it at one scale and one orientation, but for telemetry's error, which SIFT bears. (Rectified features:
Köser and Koch, "Perspectively Invariant Normal Features", 2007.)
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from nbv.config import MissionConfig
from nbv.sparse.features import Features, extract_features
from nbv.types import Floats

HALF_WIDTH_M = 3.0  # of the ground that is drawn, about the target: what all views of an orbit have in common
PIXEL_M = 0.01  # a photograph has 7.5 mm a pixel at 3.5 m; with 15 mm half the matches are left
_BORDER_PX = 4  # where the photograph ends there is an edge that is none
_NEAREST_M = 0.1


def extract_ground_features(
    image: NDArray[np.uint8], camera_from_world: Floats, config: MissionConfig
) -> Features:
    """Upright SIFT of the ground about the target, from an (H, W, 3) photograph with that reported pose (4, 4).

    Keypoints are in pixels of the photograph; their scale and orientation are those seen from above.
    """
    camera = config.camera
    x_m, y_m = _grid(*config.target_m[:2])
    across, down, depth_m = (row[0] * x_m + row[1] * y_m + row[3] for row in camera_from_world[:3])
    ahead = depth_m > _NEAREST_M
    depth_m = np.where(ahead, depth_m, 1.0)
    u_px = camera.focal_px * across / depth_m + camera.width_px / 2
    v_px = camera.focal_px * down / depth_m + camera.height_px / 2
    inside = ahead & (u_px > 1) & (u_px < camera.width_px - 1) & (v_px > 1) & (v_px < camera.height_px - 1)
    u_px, v_px = u_px.astype(np.float32), v_px.astype(np.float32)
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    above = cv2.remap(grey, u_px - 0.5, v_px - 0.5, cv2.INTER_LINEAR)
    above[~inside] = 0
    limits = replace(config.sparse, max_features=config.sparse.ground_features, first_octave=0)
    features = extract_features(above, limits, upright=True)
    if len(features) == 0:
        return features
    width = 2 * _BORDER_PX + 1
    inner = cv2.erode(inside.astype(np.uint8), np.ones((width, width), np.uint8))
    column, row = (features.keypoints[:, axis].astype(int).clip(0, len(inside) - 1) for axis in (0, 1))
    keep = inner[row, column] > 0
    keypoints = features.keypoints[keep]
    at_column, at_row = (keypoints[None, :, axis] - np.float32(0.5) for axis in (0, 1))
    for axis, pixels in enumerate((u_px, v_px)):
        keypoints[:, axis] = (
            cv2.remap(pixels, at_column, at_row, cv2.INTER_LINEAR)[0] if len(keypoints) else 0
        )
    return Features(keypoints, features.descriptors[keep])


@lru_cache(maxsize=2)
def _grid(x_m: float, y_m: float) -> tuple[Floats, Floats]:
    count = round(2 * HALF_WIDTH_M / PIXEL_M)
    offset_m = (np.arange(count) + 0.5) * PIXEL_M - HALF_WIDTH_M
    x, y = np.meshgrid(x_m + offset_m, y_m + offset_m)
    return x, y
