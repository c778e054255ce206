"""SIFT's features; photographs from far apart of level ground, which telemetry lets it match."""

import cv2
import numpy as np
from scene_helpers import around
from scipy.ndimage import gaussian_filter
from sparse_world import TARGET

from nbv.config import CameraConfig, MissionConfig, SparseConfig
from nbv.geometry.frames import look_at
from nbv.sparse.features import Correspondences, extract_features


def textured(seed=0):
    noise = gaussian_filter(np.random.default_rng(seed).standard_normal((240, 320)), 2.0)
    grey = np.clip(128 + 60 * noise / noise.std(), 0, 255).astype(np.uint8)
    return np.repeat(grey[..., None], 3, axis=2)


def test_a_featureless_image_has_no_features():
    for value in (0, 255):
        features = extract_features(np.full((240, 320, 3), value, np.uint8), SparseConfig())
        assert len(features) == 0
        assert features.keypoints.shape == (0, 4) and features.descriptors.shape == (0, 128)


def test_pixel_centres_are_at_half_integers():
    """The centre of pixel (column 100, row 70) is (100.5, 70.5), as COLMAP's cameras expect."""
    image = np.full((150, 200), 20.0)
    rows, columns = np.mgrid[:150, :200]
    image += 200 * np.exp(-((columns - 100) ** 2 + (rows - 70) ** 2) / (2 * 4.0**2))
    features = extract_features(image.astype(np.uint8), SparseConfig(first_octave=0))
    distance = np.linalg.norm(features.keypoints[:, :2] - [100.5, 70.5], axis=1)
    assert distance.min() < 0.15


CAMERA = CameraConfig()


CONFIG = SparseConfig(first_octave=0, ground_features=2000)


TEXTURE_PX_M = 0.01


def photograph(bearing_deg: float) -> tuple[np.ndarray, np.ndarray]:
    """A textured plane z = 0 from a ring at 20 degrees, and the pose."""
    noise = np.random.default_rng(3).standard_normal((1000, 1000))
    grey = gaussian_filter(noise, 2.0) + gaussian_filter(noise, 6.0) * 2
    texture = np.clip(128 + 40 * grey / grey.std(), 0, 255).astype(np.uint8)
    pose = look_at(around(90.0 - bearing_deg, 20.0, 4.0), TARGET)
    intrinsic = np.array([[CAMERA.focal_px, 0, 320 - 0.5], [0, CAMERA.focal_px, 240 - 0.5], [0, 0, 1]])
    ground = np.array(
        [[TEXTURE_PX_M, 0, -5.0], [0, TEXTURE_PX_M, -5.0], [0, 0, 1]]
    )  # texture pixel to metres
    homography = intrinsic @ pose[:3, [0, 1, 3]] @ ground
    image = cv2.warpPerspective(texture, homography, (640, 480))
    return np.repeat(image[..., None], 3, axis=2), pose


def joined(source: Correspondences, bearing_deg: float, tilt_deg: float = 0.0):
    image, pose = photograph(bearing_deg)
    told = pose.copy()
    told[:3, :3] = cv2.Rodrigues(np.deg2rad([tilt_deg, 0.0, 0.0]))[0] @ pose[:3, :3]
    return source.features(image).with_ground(source.ground_features(image, told)), pose


def test_views_60_degrees_apart_match_on_the_ground() -> None:
    source = Correspondences(MissionConfig().changed(camera=CAMERA, sparse=CONFIG, target_m=tuple(TARGET)))
    (a, pose_a), (b, pose_b) = joined(source, 0.0), joined(source, 60.0, tilt_deg=0.5)
    alone = source.pair(*(type(f)(f.keypoints[: -f.n_ground], f.descriptors[: -f.n_ground]) for f in (a, b)))
    pair = source.pair(a, b)
    assert len(alone) < 15 and len(pair) > 60
    # Matched pixels are the same place of the ground, as the true poses have it.
    places = []
    for features, pose, column in ((a, pose_a, 0), (b, pose_b, 1)):
        xy = features.keypoints[pair.matches[:, column], :2] - [320, 240]
        rays = np.c_[xy / CAMERA.focal_px, np.ones(len(xy))] @ pose[:3, :3]
        center = -pose[:3, :3].T @ pose[:3, 3]
        places.append(center - rays * (center[2] / rays[:, 2])[:, None])
    assert np.median(np.linalg.norm(places[0] - places[1], axis=1)) < 0.02
