"""The seam between photographs and the mapper: features of one image, verified matches of two."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nbv.cache import Arrays, Store, cached
from nbv.config import MissionConfig
from nbv.sparse.features import Features, extract_features
from nbv.sparse.ground_features import extract_ground_features
from nbv.sparse.matching import VerifiedPair, match_pair, verify_pair
from nbv.stopwatch import Stopwatch
from nbv.types import Floats

GROUND_MATCH_RATIO = 0.9  # nearly all ground matches are right even so, and with GNSS every one is needed


class Correspondences:
    """Features and verified pairs: pure functions of the arguments and the options, kept in the store where there is one."""

    def __init__(
        self, config: MissionConfig, store: Store | None = None, stopwatch: Stopwatch | None = None
    ) -> None:
        self.config = config
        self.stopwatch = stopwatch or Stopwatch()  # of all sparse stages
        self._store = store

    def features(self, image: NDArray[np.uint8]) -> Features:
        """Of an (H, W, 3) RGB photograph."""
        c = self.config.sparse
        inputs = [c.max_features, c.first_octave, c.peak_threshold, image]
        return self._cached_features(lambda: extract_features(image, c), "nbv.sparse.features", inputs)

    def ground_features(self, image: NDArray[np.uint8], camera_from_world: Floats) -> Features:
        """Features of the ground about the target of a photograph with that reported pose (4, 4)."""
        c = self.config
        limits = [c.camera, c.target_m, c.sparse.ground_features, c.sparse.peak_threshold]
        return self._cached_features(
            lambda: extract_ground_features(image, camera_from_world, c),
            "nbv.sparse.ground_features",
            [*limits, image, camera_from_world],
        )

    def _cached_features(self, extract: Callable[[], Features], module: str, inputs: list[Any]) -> Features:

        def make() -> Arrays:
            with self.stopwatch.timed("sparse.features"):
                features = extract()
            return {"keypoints": features.keypoints, "descriptors": features.descriptors}

        entry = cached(self._store, "features", make, code=module, inputs=inputs)
        return Features(entry["keypoints"], entry["descriptors"])

    def pair(self, a: Features, b: Features) -> VerifiedPair:
        """Verified matches of two photographs; order matters (indices of ``a``, then of ``b``)."""
        camera, c = self.config.camera, self.config.sparse

        def make() -> Arrays:
            with self.stopwatch.timed("sparse.matching"):
                matches = self._match(a, b)
            with self.stopwatch.timed("sparse.verification"):
                pair = verify_pair(a, b, matches, camera, c)
            return {"matches": pair.matches, "config": np.array(pair.config)}

        inputs = [camera, c.match_ratio, c.min_inliers, c.min_ransac_trials, a.digest, b.digest]
        entry = cached(self._store, "pairs", make, code="nbv.sparse.matching", inputs=inputs)
        return VerifiedPair(entry["matches"], int(entry["config"]))

    def _match(self, a: Features, b: Features) -> NDArray[np.uint32]:
        """Matches of the photographs, then of the ground seen from above."""
        first, second = len(a) - a.n_ground, len(b) - b.n_ground
        matches = match_pair(a.descriptors[:first], b.descriptors[:second], self.config.sparse.match_ratio)
        if not (a.n_ground and b.n_ground):
            return matches
        ground = match_pair(a.descriptors[first:], b.descriptors[second:], GROUND_MATCH_RATIO)
        return np.concatenate([matches, ground + np.array([first, second], np.uint32)])
