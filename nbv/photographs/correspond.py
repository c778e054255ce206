"""Features of the photographs, which of them may show the same thing, and their verified matches; all kept in the store."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import cv2  # noqa: F401  before pycolmap: the other order aborts the process when cv2 writes a PNG
import numpy as np
import pycolmap

from nbv.cache import Arrays, cached
from nbv.config import SparseConfig
from nbv.photographs.folder import Progress
from nbv.photographs.import_source import ImportSource
from nbv.sparse.colmap import database_cache
from nbv.sparse.features import Features, extract_features
from nbv.sparse.matching import NO_MATCHES, VerifiedPair, match_pair, matches_of_one_motion
from nbv.types import Ints

MAX_FEATURES = 8192  # the largest: where there are more they are small and repeat
# Preemptive matching (Wu 2013, "Towards linear-time incremental structure from motion", section 3): the largest features
# tell which photographs are worth matching with all.
FIRST_FEATURES, FIRST_MATCHES = 800, 4
PARTNERS = 30  # at most, best first
IN_ORDER = 2  # photographs before and after, whatever the largest features say
WORKERS = 2


@dataclass(frozen=True)
class Correspondences:
    """What structure from motion works on; photographs by their index."""

    names: list[str]
    features: list[Features]
    pairs: dict[tuple[int, int], VerifiedPair]  # (smaller index, larger index), those that have matches

    def cache(
        self, cameras: Mapping[int, pycolmap.Camera], camera_ids: Sequence[int]
    ) -> pycolmap.DatabaseCache:
        """For COLMAP; image ids count from 1 in the order of ``names``. Otherwise as `nbv.sparse.database_cache`."""
        keypoints_px = [found.keypoints[:, :2].astype(np.float64) for found in self.features]
        pairs = {(a + 1, b + 1): pair for (a, b), pair in self.pairs.items()}
        return database_cache(self.names, keypoints_px, cameras, camera_ids, pairs)


def correspondences(
    source: ImportSource, names: Sequence[str], cameras: Sequence[pycolmap.Camera]
) -> Correspondences:
    """Features of photographs and verified matches of all pairs that may overlap.

    ``names`` are theirs, in the order in which they were taken, and ``cameras`` of each, at the size that it is worked on.

    Raises
    ------
    UserError
        A file has changed or gone meanwhile.
    """
    config = SparseConfig(max_features=MAX_FEATURES)
    features = []
    for index, name in enumerate(names):
        source.progress("finding features", index, len(names))
        features.append(_features(source, name, config))
    partners = _partners(features, source.progress)
    keys = [
        f"{c.model_name} {c.width} {c.height} {c.params_to_string()} {c.has_prior_focal_length}"
        for c in cameras
    ]
    pairs: dict[tuple[int, int], VerifiedPair] = {}
    with ThreadPoolExecutor(WORKERS) as pool:

        def matched(index: int) -> Arrays:
            def one(other: int) -> VerifiedPair:
                a, b = features[index], features[other]
                matches = match_pair(a.descriptors, b.descriptors, config.match_ratio)
                estimate = pycolmap.estimate_two_view_geometry
                return matches_of_one_motion(
                    a, b, matches, (cameras[index], cameras[other]), config, estimate
                )

            found = list(pool.map(one, partners[index].tolist()))
            return {
                "counts": np.array([len(pair) for pair in found], dtype=np.int64),
                "configs": np.array([pair.config for pair in found], dtype=np.int64),
                "matches": np.concatenate([NO_MATCHES, *(pair.matches for pair in found)]),
            }

        for index, later in enumerate(partners):
            source.progress("matching photographs", index, len(partners))
            members = (index, *later.tolist())
            entry = cached(
                source.store,
                "photograph-pairs",
                lambda index=index: matched(index),  # type: ignore[misc]
                code=__name__,
                inputs=[[features[i].digest for i in members], [keys[i] for i in members], later],
            )
            split = np.split(entry["matches"], np.cumsum(entry["counts"]))
            for other, matches, kind in zip(later.tolist(), split, entry["configs"], strict=False):
                if len(matches):
                    pairs[(index, other)] = VerifiedPair(matches, int(kind))
    return Correspondences(list(names), features, pairs)


def _features(source: ImportSource, name: str, config: SparseConfig) -> Features:
    def extract() -> Arrays:
        found = extract_features(source.pixels(name), config)
        # COLMAP's limit keeps the scale that reaches it whole.
        largest = np.sort(np.argsort(-found.keypoints[:, 2], kind="stable")[:MAX_FEATURES])
        return {"keypoints": found.keypoints[largest], "descriptors": found.descriptors[largest]}

    entry = cached(
        source.store,
        "photograph-features",
        extract,
        code=__name__,
        inputs=[source.by_name[name].sha256, max(source.size_px(name)), source.upright, config],
    )
    return Features(entry["keypoints"], entry["descriptors"])


def _partners(features: Sequence[Features], progress: Progress) -> list[Ints]:
    """For each photograph the later ones that it is worth matching with."""
    count = len(features)
    largest = [
        f.descriptors[np.argsort(-f.keypoints[:, 2], kind="stable")[:FIRST_FEATURES]] for f in features
    ]
    alike = np.zeros((count, count), dtype=np.int64)
    for index in range(count):
        progress("comparing photographs", index, count)
        for other in range(index + 1, count):
            alike[index, other] = alike[other, index] = len(match_pair(largest[index], largest[other]))
    chosen = np.abs(np.subtract.outer(np.arange(count), np.arange(count))) <= IN_ORDER
    for index in range(count):
        best = np.argsort(-alike[index], kind="stable")[:PARTNERS]
        chosen[index, best[alike[index, best] >= FIRST_MATCHES]] = True
    chosen |= chosen.T
    return [np.flatnonzero(chosen[index, index + 1 :]) + index + 1 for index in range(count)]
