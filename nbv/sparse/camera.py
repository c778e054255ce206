"""The mission's pinhole camera as a COLMAP camera."""

from __future__ import annotations

import numpy as np
import pycolmap

from nbv.config import CameraConfig

CAMERA_ID = 1  # every photograph of a mission comes from one camera


def colmap_camera(camera: CameraConfig) -> pycolmap.Camera:
    """A ``PINHOLE`` camera with known intrinsics; both count pixel centres at half-integers."""
    out = pycolmap.Camera(
        model="PINHOLE",
        width=camera.width_px,
        height=camera.height_px,
        params=np.array([camera.focal_px, camera.focal_px, camera.width_px / 2, camera.height_px / 2]),
        camera_id=CAMERA_ID,
    )
    out.has_prior_focal_length = True
    return out
