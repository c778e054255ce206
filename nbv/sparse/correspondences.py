"""The seam between photographs and the mapper: features of one image, verified matches of two.

Both are pure functions of their arguments and the options, so a content-addressed cache can stand in front
of :class:`ComputedCorrespondences` (key a photograph by its pixels, a pair by the two ``Features.digest``).
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from nbv.config import CameraConfig, SparseConfig
from nbv.sparse.eight_bit_matching import match_pair_fast
from nbv.sparse.features import Features, extract_features
from nbv.sparse.matching import VerifiedPair, verify_pair
from nbv.sparse.timing import StageTimer


class Correspondences(Protocol):
    """Where features and verified pairs come from: computed, or a cache in front of that."""

    timer: StageTimer

    def features(self, image: NDArray[np.uint8]) -> Features:
        """Features of an (H, W, 3) RGB photograph."""
        ...

    def pair(self, a: Features, b: Features) -> VerifiedPair:
        """Verified matches of two photographs; order matters (indices of ``a``, then of ``b``)."""
        ...


class ComputedCorrespondences:
    """Computes everything, remembers nothing."""

    def __init__(self, camera: CameraConfig, config: SparseConfig) -> None:
        self.camera = camera
        self.config = config
        self.timer = StageTimer()

    def features(self, image: NDArray[np.uint8]) -> Features:
        """See :func:`nbv.sparse.features.extract_features`."""
        with self.timer("features"):
            return extract_features(image, self.config)

    def pair(self, a: Features, b: Features) -> VerifiedPair:
        """See :func:`nbv.sparse.matching.match_pair` and :func:`nbv.sparse.matching.verify_pair`."""
        with self.timer("matching"):
            matches = match_pair_fast(a.descriptors, b.descriptors, self.config.match_ratio)
        with self.timer("verification"):
            return verify_pair(a, b, matches, self.camera, self.config)
