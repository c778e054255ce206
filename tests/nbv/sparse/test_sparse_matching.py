import numpy as np
import pycolmap
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nbv.config import CameraConfig, SparseConfig
from nbv.geometry.frames import intrinsic_matrix, look_at
from nbv.sparse.features import Features
from nbv.sparse.matching import match_pair, verify_pair


def descriptors(rng, count, like=None, noise=0.0):
    """SIFT-like: nonnegative, norm 512, uint8."""
    raw = np.abs(rng.standard_normal((count, 128)))
    if like is not None:
        raw = like / 512.0 + noise * np.abs(rng.standard_normal(like.shape))
    raw /= np.linalg.norm(raw, axis=1, keepdims=True)
    return np.clip(np.round(512 * raw), 0, 255).astype(np.uint8)


def reference(a, b, ratio, limit):
    """COLMAP's rule, one descriptor at a time, in integers and doubles."""

    def one_way(x, y):
        out = {}
        for i, row in enumerate(x.astype(np.int64)):
            dots = y.astype(np.int64) @ row
            best = int(dots.argmax())
            angles = np.arccos(np.minimum(dots / 512.0**2, 1.0))
            others = np.delete(angles, best)
            second = others.min() if len(others) else np.pi / 2
            if angles[best] <= limit and angles[best] < ratio * second:
                out[i] = best
        return out

    forward, backward = one_way(a, b), one_way(b, a)
    return [(i, j) for i, j in sorted(forward.items()) if backward.get(j) == i]


@settings(max_examples=25)
@given(st.integers(0, 10_000), st.integers(1, 60), st.integers(1, 60), st.floats(0.0, 0.08))
def test_agrees_with_one_descriptor_at_a_time(seed, count_a, count_b, noise):
    rng = np.random.default_rng(seed)
    a = descriptors(rng, count_a)
    b = descriptors(rng, count_b)
    shared = min(count_a, count_b) // 2
    b[:shared] = descriptors(rng, shared, like=a[:shared].astype(float), noise=noise)
    for ratio in (0.6, 0.8, 0.95):
        got = match_pair(a, b, ratio, 0.7)
        assert got.dtype == np.uint32 and got.shape[1] == 2
        assert [tuple(m) for m in got.tolist()] == reference(a, b, ratio, 0.7)


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
