"""SIFT, matching, alignment with telemetry, and signals that COLMAP leaves alone."""

import signal
import subprocess
import sys

import cv2
import numpy as np
import pycolmap
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scene_helpers import around
from scipy.ndimage import gaussian_filter
from scipy.spatial.transform import Rotation
from sparse_world import TARGET, moved, ring_captures

from nbv.config import TELEMETRY_LEVELS, CameraConfig, MissionConfig, SparseConfig
from nbv.errors import MissionFailure
from nbv.geometry.frames import camera_centers_m, look_at
from nbv.sparse.alignment import align_cameras
from nbv.sparse.colmap import camera_from_world_poses
from nbv.sparse.features import Correspondences, extract_features, match_pair


def textured(seed=0):
    noise = gaussian_filter(np.random.default_rng(seed).standard_normal((240, 320)), 2.0)
    grey = np.clip(128 + 60 * noise / noise.std(), 0, 255).astype(np.uint8)
    return np.repeat(grey[..., None], 3, axis=2)


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


def descriptors(rng, count, like=None, noise=0.0):
    """SIFT-like: nonnegative, norm 512, uint8."""
    raw = np.abs(rng.standard_normal((count, 128)))
    if like is not None:
        raw = like / 512.0 + noise * np.abs(rng.standard_normal(like.shape))
    raw /= np.linalg.norm(raw, axis=1, keepdims=True)
    return np.clip(np.round(512 * raw), 0, 255).astype(np.uint8)


def test_agrees_with_colmap():
    rng = np.random.default_rng(2)
    a = descriptors(rng, 300)
    b = np.concatenate([descriptors(rng, 200, like=a[:200].astype(float), noise=0.05), descriptors(rng, 80)])
    rng.shuffle(b)
    options = pycolmap.FeatureMatchingOptions()
    options.num_threads = 1
    options.use_gpu = False
    options.sift.cpu_brute_force_matcher = True
    matcher = pycolmap.FeatureMatcher.create(options, pycolmap.Device.cpu)
    arguments = []
    for d in (a, b):
        arguments.append(pycolmap.keypoints_from_matrix(np.zeros((len(d), 4), np.float32)))
        arguments.append(pycolmap.FeatureDescriptors(pycolmap.FeatureExtractorType.SIFT, d))
    theirs = np.asarray(matcher.match(*arguments))
    ours = match_pair(a, b)
    assert len(ours) > 150
    assert {tuple(m) for m in ours.tolist()} == {tuple(m) for m in theirs.tolist()}


TELEMETRY = np.array([c.camera_from_world for c in ring_captures(24)])


def in_model_frame(telemetry, scale, rotation, translation):
    """Poses in the frame ``model = scale * rotation @ world + translation``."""
    poses = telemetry.copy()
    poses[:, :3, :3] = telemetry[:, :3, :3] @ rotation.T
    poses[:, :3, 3] = scale * telemetry[:, :3, 3] - poses[:, :3, :3] @ translation
    return poses


@settings(max_examples=30)
@given(st.integers(0, 10_000), st.floats(0.05, 20.0))
def test_undoes_any_similarity(seed, scale):
    rng = np.random.default_rng(seed)
    rotation = Rotation.random(random_state=seed).as_matrix()
    model = in_model_frame(TELEMETRY, scale, rotation, rng.uniform(-50, 50, 3))
    alignment = align_cameras(model, TELEMETRY, 0.1)
    assert alignment.world_from_model.scale == pytest.approx(1 / scale, rel=1e-6)
    assert alignment.rms_m < 1e-6 and alignment.max_m < 1e-6 and len(alignment.outliers) == 0
    assert alignment.rotation_errors_deg.max() < 1e-3
    world = camera_from_world_poses(model, alignment.world_from_model)
    np.testing.assert_allclose(world, TELEMETRY, atol=1e-6)


@pytest.mark.parametrize("wrong", [(3,), (0, 7, 20)])
def test_names_the_few_cameras_that_disagree(wrong):
    model = TELEMETRY.copy()
    for index in wrong:
        model[index] = moved(model[index], (1.0, -0.7, 0.4 + 0.1 * index))
    model = in_model_frame(model, 2.5, Rotation.from_euler("xyz", [1, 2, 3]).as_matrix(), [3.0, 1.0, 2.0])
    alignment = align_cameras(model, TELEMETRY, 0.1)
    assert tuple(alignment.outliers) == wrong
    assert alignment.rms_m < 1e-6
    assert alignment.residuals_m[list(wrong)].min() > 1.0


def fails(model, telemetry=TELEMETRY, reason="wrong_model"):
    with pytest.raises(MissionFailure) as caught:
        align_cameras(model, telemetry, 0.1)
    assert caught.value.reason == reason
    return caught.value.message


def test_shuffled_telemetry_is_a_wrong_model():
    order = np.random.default_rng(1).permutation(24)
    assert "telemetry" in fails(TELEMETRY[order])


def test_a_mirrored_single_ring_is_found_by_its_orientations():
    """The centres of one ring lie in a plane, so that centres alone cannot tell its mirror image."""
    mirror = np.diag([1.0, 1.0, -1.0])
    ring = TELEMETRY[:12]
    model = ring.copy()
    model[:, :3, :3] = mirror @ ring[:, :3, :3] @ mirror
    model[:, :3, 3] = ring[:, :3, 3] @ mirror
    assert "mirrored" in fails(model, ring)


def test_collapsed_and_tiny_models():
    same = np.repeat(TELEMETRY[:1], 24, axis=0)
    assert "collapsed" in fails(same)
    assert "only 2" in fails(TELEMETRY[:2], TELEMETRY[:2])
    line = np.array([moved(TELEMETRY[0], (i, 0, 0)) for i in range(5)])
    assert "line" in fails(line, line)


def test_attitudes_hold_the_turn_that_drift_would_give():
    telemetry = TELEMETRY_LEVELS["gnss"]
    rng = np.random.default_rng(2)
    errors_deg = {False: [], True: []}
    for _ in range(20):
        reported = TELEMETRY.copy()
        centers = camera_centers_m(TELEMETRY) + rng.normal(0, 0.5, (len(TELEMETRY), 3))
        turns = Rotation.from_rotvec(np.deg2rad(rng.normal(0, 1.0, (len(TELEMETRY), 3)))).as_matrix()
        reported[:, :3, :3] = turns @ TELEMETRY[:, :3, :3]
        reported[:, :3, 3] = -np.einsum("mij,mj->mi", reported[:, :3, :3], centers)
        for uses in errors_deg:
            found = align_cameras(TELEMETRY, reported, 2.0, telemetry if uses else None).world_from_model
            errors_deg[uses].append(np.rad2deg(Rotation.from_matrix(found.rotation).magnitude()))
    assert np.mean(errors_deg[True]) < 0.5
    assert np.mean(errors_deg[True]) < np.mean(errors_deg[False]) / 4


WAITS = """
import signal, sys
{before}
import nbv.sparse
print("ready", flush=True)
signal.pause()
"""


@pytest.mark.parametrize(
    ("before", "status"),
    [("", -signal.SIGTERM), ("signal.signal(signal.SIGTERM, lambda number, frame: sys.exit(7))", 7)],
)
def test_a_termination_shows_no_stack_trace_and_reaches_its_handler(before, status):
    command, pipe = [sys.executable, "-c", WAITS.format(before=before)], subprocess.PIPE
    with subprocess.Popen(command, stdout=pipe, stderr=pipe, text=True) as waiting:
        assert waiting.stdout is not None and waiting.stdout.readline() == "ready\n"
        waiting.terminate()
        _, said = waiting.communicate(timeout=60)
    assert (waiting.returncode, said) == (status, "")
