"""SIFT features of one photograph: a pure function of (image, options)."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
import pycolmap
from numpy.typing import NDArray

from nbv.config import SparseConfig


@dataclass(frozen=True)
class Features:
    """Keypoints and descriptors of one photograph, K of them (K may be 0)."""

    keypoints: NDArray[np.float32]  # (K, 4) x_px, y_px, scale_px, orientation_rad; pixel centres at halves
    descriptors: NDArray[np.uint8]  # (K, 128) L1-root SIFT, Euclidean norm about 512
    n_ground: int = 0  # the last so many are of the ground seen from above, and match only one another

    def __len__(self) -> int:
        return len(self.keypoints)

    @cached_property
    def digest(self) -> str:
        """Hexadecimal SHA-256 of the contents."""
        hasher = hashlib.sha256(np.ascontiguousarray(self.keypoints).tobytes())
        hasher.update(np.ascontiguousarray(self.descriptors).tobytes())
        return hasher.hexdigest() + (f"-{self.n_ground}" if self.n_ground else "")

    def with_ground(self, ground: Features) -> Features:
        """These, then those of the ground (`nbv.sparse.ground_features`)."""
        return Features(
            np.concatenate([self.keypoints, ground.keypoints]),
            np.concatenate([self.descriptors, ground.descriptors]),
            len(ground),
        )


def extract_features(image: NDArray[np.uint8], config: SparseConfig, *, upright: bool = False) -> Features:
    """SIFT (Lowe 2004, COLMAP's CPU implementation) of an (H, W, 3) or (H, W) uint8 image; ``upright``: no orientation is sought.

    One thread, deterministic. ``config.max_features`` is COLMAP's soft limit: coarse scales come first
    and the scale that reaches the limit is kept whole. A featureless image gives empty arrays, never an
    error.
    """
    bitmap = pycolmap.Bitmap.from_array(np.ascontiguousarray(image))
    if not bitmap.is_grey:
        bitmap = bitmap.clone_as_grey()
    extractor = _extractor(config.max_features, config.first_octave, config.peak_threshold, upright)
    keypoints, descriptors = extractor.extract(bitmap)
    return Features(
        np.array(pycolmap.keypoints_to_matrix(keypoints)[:, :4], dtype=np.float32),
        np.array(descriptors.data, dtype=np.uint8),
    )


@lru_cache(maxsize=4)
def _extractor(
    max_features: int, first_octave: int, peak_threshold: float, upright: bool
) -> pycolmap.FeatureExtractor:
    options = pycolmap.FeatureExtractionOptions()
    options.num_threads = 1
    options.use_gpu = False
    options.sift.max_num_features = max_features
    options.sift.first_octave = first_octave
    options.sift.peak_threshold = peak_threshold
    options.sift.upright = upright
    return pycolmap.FeatureExtractor.create(options, pycolmap.Device.cpu)
