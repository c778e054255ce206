"""The seam between photographs and the mapper: features of one image, verified matches of two.

Both are pure functions of their arguments and the options, so a content-addressed cache can stand in front
of :class:`ComputedCorrespondences` (key a photograph by its pixels, a pair by the two ``Features.digest``).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from nbv.config import CameraConfig, SparseConfig
from nbv.sparse.eight_bit_matching import match_pair_fast
from nbv.sparse.features import Features, extract_features
from nbv.sparse.ground_features import extract_ground_features
from nbv.sparse.matching import VerifiedPair, verify_pair
from nbv.sparse.timing import StageTimer
from nbv.types import Floats

GROUND_MATCH_RATIO = 0.9  # nearly all ground matches are right even so, and with GNSS every one is needed


class Correspondences(Protocol):
    """Where features and verified pairs come from: computed, or a cache in front of that."""

    timer: StageTimer

    def features(self, image: NDArray[np.uint8]) -> Features:
        """Features of an (H, W, 3) RGB photograph."""
        ...

    def ground_features(
        self, image: NDArray[np.uint8], camera_from_world: Floats, target_m: Floats
    ) -> Features:
        """Features of the ground about ``target_m`` (3,) of a photograph with that reported pose (4, 4)."""
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

    def ground_features(
        self, image: NDArray[np.uint8], camera_from_world: Floats, target_m: Floats
    ) -> Features:
        """See :func:`nbv.sparse.ground_features.extract_ground_features`."""
        limits = (self.config.ground_features, self.config.peak_threshold)
        with self.timer("features"):
            return extract_ground_features(image, camera_from_world, self.camera, target_m, *limits)

    def pair(self, a: Features, b: Features) -> VerifiedPair:
        """See :func:`nbv.sparse.matching.match_pair` and :func:`nbv.sparse.matching.verify_pair`."""
        with self.timer("matching"):
            matches = self._match(a, b)
        with self.timer("verification"):
            return verify_pair(a, b, matches, self.camera, self.config)

    def _match(self, a: Features, b: Features) -> NDArray[np.uint32]:
        """Matches of the photographs, then of the ground seen from above."""
        first, second = len(a) - a.n_ground, len(b) - b.n_ground
        matches = match_pair_fast(a.descriptors[:first], b.descriptors[:second], self.config.match_ratio)
        if not (a.n_ground and b.n_ground):
            return matches
        ground = match_pair_fast(a.descriptors[first:], b.descriptors[second:], GROUND_MATCH_RATIO)
        return np.concatenate([matches, ground + np.array([first, second], np.uint32)])


def pairs_near(
    pairs: Mapping[tuple[int, int], VerifiedPair], image_ids: Sequence[int]
) -> dict[tuple[int, int], VerifiedPair]:
    """Of ``pairs``, those of these images and of the images that they were matched with.

    Registration and triangulation need those of the images themselves; the others let tracks that the new
    observations join grow and merge. What lies farther is left to the next global adjustment, which sees all
    pairs. Every image keeps one pair at least, since COLMAP's graph drops images that have none.
    """
    own = set(image_ids)
    near = own | {i for ids in pairs if not own.isdisjoint(ids) for i in ids}
    chosen = {ids: pair for ids, pair in pairs.items() if not near.isdisjoint(ids)}
    held = {i for ids in chosen for i in ids}
    for ids, pair in pairs.items():
        if not held.issuperset(ids):
            chosen[ids] = pair
            held.update(ids)
    return chosen
