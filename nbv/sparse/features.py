"""SIFT features of one photograph: a pure function of (image, options)."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any

import cv2
import numpy as np
import pycolmap
from numpy.typing import NDArray

from nbv.cache import Arrays, Store, cached
from nbv.config import CameraConfig, MissionConfig, SparseConfig
from nbv.process import Stopwatch
from nbv.sparse.colmap import colmap_camera
from nbv.types import Floats

# Features of the ground as seen from above: what holds photographs together that look from far apart.
#
# SIFT matches little between views 30 degrees and more apart (Mikolajczyk and Schmid, "A Performance Evaluation of Local
# Descriptors", PAMI 2005). But telemetry says where the level ground z = 0 lies in a photograph: drawn from straight above,
# all photographs show it at one scale and one orientation, but for telemetry's error, which SIFT bears. (Rectified features:
# Köser and Koch, "Perspectively Invariant Normal Features", 2007.)


HALF_WIDTH_M = 3.0  # of the ground that is drawn, about the target: what all views of an orbit have in common
PIXEL_M = 0.01  # a photograph has 7.5 mm a pixel at 3.5 m; with 15 mm half the matches are left
_BORDER_PX = 4  # where the photograph ends there is an edge that is none
_NEAREST_M = 0.1


def extract_ground_features(
    image: NDArray[np.uint8], camera_from_world: Floats, config: MissionConfig
) -> Features:
    """Upright SIFT of the ground about the target, from an (H, W, 3) photograph with that reported pose (4, 4).

    Keypoints are in pixels of the photograph; their scale and orientation are those seen from above.
    """
    camera = config.camera
    x_m, y_m = _grid(*config.target_m[:2])
    across, down, depth_m = (row[0] * x_m + row[1] * y_m + row[3] for row in camera_from_world[:3])
    ahead = depth_m > _NEAREST_M
    depth_m = np.where(ahead, depth_m, 1.0)
    u_px = camera.focal_px * across / depth_m + camera.width_px / 2
    v_px = camera.focal_px * down / depth_m + camera.height_px / 2
    inside = ahead & (u_px > 1) & (u_px < camera.width_px - 1) & (v_px > 1) & (v_px < camera.height_px - 1)
    u_px, v_px = u_px.astype(np.float32), v_px.astype(np.float32)
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    above = cv2.remap(grey, u_px - 0.5, v_px - 0.5, cv2.INTER_LINEAR)
    above[~inside] = 0
    limits = replace(config.sparse, max_features=config.sparse.ground_features, first_octave=0)
    features = extract_features(above, limits, upright=True)
    if len(features) == 0:
        return features
    width = 2 * _BORDER_PX + 1
    inner = cv2.erode(inside.astype(np.uint8), np.ones((width, width), np.uint8))
    column, row = (features.keypoints[:, axis].astype(int).clip(0, len(inside) - 1) for axis in (0, 1))
    keep = inner[row, column] > 0
    keypoints = features.keypoints[keep]
    at_column, at_row = (keypoints[None, :, axis] - np.float32(0.5) for axis in (0, 1))
    for axis, pixels in enumerate((u_px, v_px)):
        keypoints[:, axis] = (
            cv2.remap(pixels, at_column, at_row, cv2.INTER_LINEAR)[0] if len(keypoints) else 0
        )
    return Features(keypoints, features.descriptors[keep])


@lru_cache(maxsize=2)
def _grid(x_m: float, y_m: float) -> tuple[Floats, Floats]:
    count = round(2 * HALF_WIDTH_M / PIXEL_M)
    offset_m = (np.arange(count) + 0.5) * PIXEL_M - HALF_WIDTH_M
    x, y = np.meshgrid(x_m + offset_m, y_m + offset_m)
    return x, y


# The seam between photographs and the mapper: features of one image, verified matches of two.


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
            "nbv.sparse.features",
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
                first, second = len(a) - a.n_ground, len(b) - b.n_ground
                matches = match_pair(a.descriptors[:first], b.descriptors[:second], c.match_ratio)
                if a.n_ground and b.n_ground:  # then of the ground seen from above
                    ground = match_pair(a.descriptors[first:], b.descriptors[second:], GROUND_MATCH_RATIO)
                    matches = np.concatenate([matches, ground + np.array([first, second], np.uint32)])
            with self.stopwatch.timed("sparse.verification"):
                pair = verify_pair(a, b, matches, camera, c)
            return {"matches": pair.matches, "config": np.array(pair.config)}

        inputs = [camera, c.match_ratio, c.min_inliers, c.min_ransac_trials, a.digest, b.digest]
        entry = cached(self._store, "pairs", make, code="nbv.sparse.features", inputs=inputs)
        return VerifiedPair(entry["matches"], int(entry["config"]))


# Descriptor matching and two-view verification: pure functions of two photographs.


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
        """These, then those of the ground (`nbv.sparse.features`)."""
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
