import numpy as np
from scipy.ndimage import gaussian_filter

from nbv.config import SparseConfig
from nbv.sparse.features import extract_features


def textured(seed=0):
    noise = gaussian_filter(np.random.default_rng(seed).standard_normal((240, 320)), 2.0)
    grey = np.clip(128 + 60 * noise / noise.std(), 0, 255).astype(np.uint8)
    return np.repeat(grey[..., None], 3, axis=2)


def test_options_reach_the_detector():
    base = len(extract_features(textured(), SparseConfig(first_octave=0)))
    assert len(extract_features(textured(), SparseConfig(first_octave=0, peak_threshold=0.05))) < base
    assert len(extract_features(textured(), SparseConfig(first_octave=-1))) > base
    limited = extract_features(textured(), SparseConfig(first_octave=0, max_features=50))
    assert 50 <= len(limited) < base / 2
    full = extract_features(textured(), SparseConfig(first_octave=0))
    assert limited.keypoints[:, 2].min() >= np.median(full.keypoints[:, 2])  # coarse scales are kept


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
