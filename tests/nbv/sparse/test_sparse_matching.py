import numpy as np
import pycolmap
import pytest

from nbv.config import CameraConfig, SparseConfig
from nbv.geometry.frames import intrinsic_matrix, look_at
from nbv.sparse.features import Features, match_pair, verify_pair


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


def two_views(inliers, outliers, seed=0):
    rng = np.random.default_rng(seed)
    camera = CameraConfig()
    world = rng.uniform([-1, -1, 0], [1, 1, 1.6], (inliers, 3))
    features = []
    for position in ((4.0, 0.0, 1.8), (3.5, 1.6, 2.0)):
        pose = look_at(np.array(position), np.array([0, 0, 0.8]))
        pixels = (world @ pose[:3, :3].T + pose[:3, 3]) @ intrinsic_matrix(camera).T
        pixels = pixels[:, :2] / pixels[:, 2:] + rng.normal(0, 0.3, (inliers, 2))
        pixels = np.concatenate([pixels, rng.uniform(0, 480, (outliers, 2))])
        keypoints = np.c_[pixels, np.ones((len(pixels), 2))].astype(np.float32)
        features.append(Features(keypoints, np.zeros((len(pixels), 128), np.uint8)))
    matches = np.repeat(np.arange(inliers + outliers, dtype=np.uint32)[:, None], 2, axis=1)
    return *features, matches, camera


def test_verification_finds_the_planted_motion_and_is_repeatable():
    a, b, matches, camera = two_views(80, 40)
    pair = verify_pair(a, b, matches, camera, SparseConfig())
    kept = set(pair.matches[:, 0].tolist())
    assert len(kept & set(range(80))) >= 78
    assert len(kept - set(range(80))) <= 8  # an outlier can lie on its epipolar line by chance
    pycolmap.set_random_seed(999)  # the result must not depend on global state
    again = verify_pair(a, b, matches, camera, SparseConfig())
    np.testing.assert_array_equal(pair.matches, again.matches)
    assert pair.config == again.config


@pytest.mark.parametrize("inliers, outliers", [(0, 60), (14, 0)])
def test_verification_refuses_noise_and_too_few(inliers, outliers):
    a, b, matches, camera = two_views(inliers, outliers)
    assert len(verify_pair(a, b, matches, camera, SparseConfig(min_inliers=25 if outliers else 15))) == 0
