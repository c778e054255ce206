"""Descriptor matching and two-view verification: pure functions of two photographs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pycolmap
from numpy.typing import NDArray

from nbv.config import CameraConfig, SparseConfig
from nbv.sparse.colmap import colmap_camera
from nbv.sparse.features import Features

MAX_DISTANCE_RAD = 0.7  # COLMAP's default largest angle between matching descriptors
_NORM_SQUARED = np.float32(512.0**2)  # COLMAP stores unit descriptors times 512 as uint8
BLOCK_BYTES = 4 << 20  # a block of similarities that stays in the cache
_RANSAC_SEED = 0
NO_MATCHES = np.zeros((0, 2), np.uint32)
Descriptors = NDArray[np.uint8]


@dataclass(frozen=True)
class VerifiedPair:
    """Matches of two photographs that agree with one rigid motion; no matches if there is none."""

    matches: NDArray[np.uint32]  # (M, 2) keypoint indices in the first and in the second photograph
    config: int  # pycolmap.TwoViewGeometryConfiguration

    def __len__(self) -> int:
        return len(self.matches)


def nearest_two(
    a: Descriptors, b: Descriptors
) -> tuple[NDArray[np.int64], NDArray[np.float32], NDArray[np.float32]]:
    """For each row of ``a`` (Ka, 128) the index of the nearest row of ``b`` (Kb, 128), and its product and the next."""
    left, right = a.astype(np.float32), b.T.astype(np.float32)
    nearest = np.empty(len(a), np.int64)
    best = np.empty(len(a), np.float32)
    second = np.zeros(len(a), np.float32)  # with a single candidate the second best is at a right angle
    step = max(1, BLOCK_BYTES // (4 * len(b)))
    for start in range(0, len(a), step):
        block = left[start : start + step] @ right
        rows = np.arange(len(block))
        index = block.argmax(axis=1)
        nearest[start : start + step] = index
        best[start : start + step] = block[rows, index]
        if len(b) > 1:
            block[rows, index] = -1.0
            second[start : start + step] = block.max(axis=1)
    return nearest, best, second


def match_pair(a: Descriptors, b: Descriptors, max_ratio: float = 0.8) -> NDArray[np.uint32]:
    """(M, 2) mutual nearest neighbours of two descriptor sets (Ka, 128) and (Kb, 128), sorted by the first.

    COLMAP's rule, by the angle between descriptors, in both directions; pycolmap's own matcher takes a hundred times as long.
    Exact: sums of products of bytes stay below 2**24, so the float32 matrix product has no rounding
    and the result does not depend on the linear-algebra library or its threads.
    """
    if len(a) == 0 or len(b) == 0:
        return NO_MATCHES

    def accepted(x: Descriptors, y: Descriptors) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
        index, *products = nearest_two(x, y)
        best_rad, second_rad = (np.arccos(np.minimum(p / _NORM_SQUARED, 1.0)) for p in products)
        return index, (best_rad <= MAX_DISTANCE_RAD) & (best_rad < max_ratio * second_rad)

    forward, accepted_forward = accepted(a, b)
    rows = np.flatnonzero(accepted_forward)
    if len(rows) == 0:
        return NO_MATCHES
    # Only columns that some row has chosen need the check in the other direction.
    columns, position = np.unique(forward[rows], return_inverse=True)
    backward, accepted_back = accepted(b[columns], a)
    mutual = accepted_back[position] & (backward[position] == rows)
    return np.stack([rows[mutual], forward[rows[mutual]]], axis=1).astype(np.uint32)


def verify_pair(
    a: Features, b: Features, matches: NDArray[np.uint32], camera: CameraConfig, config: SparseConfig
) -> VerifiedPair:
    """Keep the matches (M, 2) that fit one two-view geometry with known intrinsics (COLMAP's RANSAC, with a fixed seed)."""
    rejected = VerifiedPair(NO_MATCHES, int(pycolmap.TwoViewGeometryConfiguration.DEGENERATE))
    if len(matches) < config.min_inliers:
        return rejected
    options = pycolmap.TwoViewGeometryOptions()
    options.min_num_inliers = config.min_inliers
    options.detect_watermark = False  # borders that are alike are no reason to give a pair up
    options.ransac.random_seed = _RANSAC_SEED
    options.ransac.num_threads = 1
    options.ransac.min_num_trials = config.min_ransac_trials
    # Only the keypoints that are matched: to hand over all of them takes longer than a short RANSAC.
    count = np.arange(len(matches), dtype=np.uint32)
    colmap = colmap_camera(camera)
    geometry = pycolmap.estimate_calibrated_two_view_geometry(
        colmap,
        a.keypoints[matches[:, 0], :2].astype(np.float64),
        colmap,
        b.keypoints[matches[:, 1], :2].astype(np.float64),
        np.stack([count, count], axis=1),
        options,
    )
    inliers = np.array(geometry.inlier_matches, dtype=np.uint32).reshape(-1, 2)
    if len(inliers) < config.min_inliers:
        return rejected
    return VerifiedPair(matches[inliers[:, 0]], int(geometry.config))
