"""Where a photograph that is no part of a model was taken, from the model's points that it shows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pycolmap

from nbv.config import CameraConfig
from nbv.sparse.camera import colmap_camera
from nbv.types import Floats

_SEED = 0


@dataclass(frozen=True)
class Located:
    """A pose found in a model."""

    camera_from_world: Floats  # (4, 4)
    inliers: int  # points of the model that agree with it
    reprojection_error_px: float  # their median


def locate(points_px: Floats, points_m: Floats, camera: CameraConfig, min_inliers: int) -> Located | None:
    """The pose from which points (N, 3) of the world appear at (N, 2): COLMAP's RANSAC and refinement, or None.

    Parameters
    ----------
    points_px, points_m
        Matched, in the same order.
    camera
        Known intrinsics.
    min_inliers
        Fewer points in agreement are no pose.
    """
    if len(points_px) < min_inliers:
        return None
    options = pycolmap.AbsolutePoseEstimationOptions()
    options.ransac.random_seed = _SEED
    found = pycolmap.estimate_and_refine_absolute_pose(points_px, points_m, colmap_camera(camera), options)
    if found is None or found["num_inliers"] < min_inliers:
        return None
    pose = np.eye(4)
    pose[:3] = found["cam_from_world"].matrix()
    seen_m = points_m[found["inlier_mask"]] @ pose[:3, :3].T + pose[:3, 3]
    at_px = camera.focal_px * seen_m[:, :2] / seen_m[:, 2:] + [camera.width_px / 2, camera.height_px / 2]
    errors_px = np.linalg.norm(at_px - points_px[found["inlier_mask"]], axis=1)
    return Located(pose, int(found["num_inliers"]), float(np.median(errors_px)))
