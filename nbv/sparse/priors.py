"""Telemetry as pose priors: an adjustment of all cameras and points in which telemetry weighs by its covariance."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pycolmap

from nbv.types import Floats

FEWEST_CAMERAS = 6  # below, the model is too small to be held by positions that err


def adjust_with_priors(
    reconstruction: pycolmap.Reconstruction,
    centers_m: Mapping[int, Floats],
    variances_m2: tuple[float, float, float],
    options: pycolmap.BundleAdjustmentOptions,
) -> None:
    """Put the model into the world frame and adjust it, in place, against pixels and priors.

    COLMAP's pose-prior bundle adjustment: residuals of pixels, and of camera centres whitened by the covariance
    (pycolmap's ``create_pose_prior_bundle_adjuster``). Pixels count with a standard deviation of one pixel. ``centers_m`` (3,) are by
    image id where telemetry says the cameras are, ``variances_m2`` (3,) how sure it is: east, north, up.
    """
    ids = sorted(int(i) for i in reconstruction.reg_image_ids())
    if len(ids) < FEWEST_CAMERAS:
        return
    config = pycolmap.BundleAdjustmentConfig()
    found = []
    for image_id in ids:
        config.add_image(image_id)
        prior = pycolmap.PosePrior()
        prior.pose_prior_id = image_id
        prior.corr_data_id = reconstruction.image(image_id).data_id
        prior.position = np.asarray(centers_m[image_id], dtype=float)
        prior.position_covariance = np.diag(variances_m2)
        prior.coordinate_system = pycolmap.PosePriorCoordinateSystem.CARTESIAN
        found.append(prior)
    for camera_id in reconstruction.cameras:
        config.set_constant_cam_intrinsics(camera_id)
    prior_options = pycolmap.PosePriorBundleAdjustmentOptions()
    prior_options.alignment_ransac.random_seed = 0
    adjuster = pycolmap.create_pose_prior_bundle_adjuster(
        options, prior_options, config, found, reconstruction
    )
    adjuster.solve()
