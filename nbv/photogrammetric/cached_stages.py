"""The content-addressed store in front of photographs, features, pairs and the seed model.

Each wrapper has the face of what it wraps. Keys hold everything that decides the content (pixels, poses,
options, package versions, `STAGE_VERSION`), so a mission with a store and one without give the same bits.
"""

from __future__ import annotations

import dataclasses
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from nbv.cache import Store, digest
from nbv.config import CameraConfig, MissionConfig, SparseConfig, canonical
from nbv.photogrammetric.studio import Studio
from nbv.provenance import versions
from nbv.rocks import Rock
from nbv.sparse.correspondences import ComputedCorrespondences
from nbv.sparse.features import Features
from nbv.sparse.matching import VerifiedPair
from nbv.sparse.reconstructor import SparseReconstructor
from nbv.types import Capture, UpdateReport, Viewpoint

# Raise when a stage's code changes what it computes.
STAGE_VERSION = 1


class CachedStudio:
    """Photographs by (rock, replicate, viewpoint, pose, camera, scene)."""

    def __init__(
        self, studio: Studio, store: Store, rock: Rock, replicate: int, config: MissionConfig
    ) -> None:
        self._studio, self._store, self._target_m = studio, store, config.target_m
        self._identity = [
            STAGE_VERSION, rock.sha256, replicate, config.scene.backend, versions().get("open3d-cpu", versions().get("open3d", "")),
            dataclasses.asdict(config.camera), dataclasses.asdict(config.scene),
        ]  # fmt: skip

    def take_photograph(self, viewpoint: Viewpoint, position_m: np.ndarray) -> Capture:
        """See `nbv.photogrammetric.studio.Studio.take_photograph`."""
        pose = self._studio.aim(position_m)
        key = digest(self._identity, viewpoint.id, pose)
        if (entry := self._store.get("photographs", key)) is not None:
            return Capture(f"{viewpoint.id}.png", viewpoint, pose, entry["image"])
        capture = self._studio.take_photograph(viewpoint, position_m)
        assert capture.image is not None
        self._store.put("photographs", key, {"image": capture.image})
        return capture

    def close(self) -> None:
        """See `nbv.photogrammetric.studio.Studio.close`."""
        self._studio.close()


class CachedCorrespondences:
    """Features by pixels and options; verified pairs by the two feature sets and options."""

    def __init__(self, camera: CameraConfig, config: SparseConfig, store: Store) -> None:
        self._computed = ComputedCorrespondences(camera, config)
        self.timer = self._computed.timer
        self._store = store
        common = [STAGE_VERSION, versions()["pycolmap"]]
        self._feature_options = [*common, config.max_features, config.first_octave, config.peak_threshold]
        self._pair_options = [*common, dataclasses.asdict(camera), config.match_ratio, config.min_inliers]
        # Left out where it is COLMAP's, so that pairs kept before it was an option stay valid.
        if config.min_ransac_trials != SparseConfig().min_ransac_trials:
            self._pair_options.append(config.min_ransac_trials)
        self._keys: dict[int, tuple[Features, str]] = {}  # holds the features, so that ids stay theirs

    def features(self, image: NDArray[np.uint8]) -> Features:
        """See `nbv.sparse.features.extract_features`."""
        key = digest(self._feature_options, image)
        if (entry := self._store.get("features", key)) is not None:
            return Features(entry["keypoints"], entry["descriptors"])
        features = self._computed.features(image)
        self._store.put(
            "features", key, {"keypoints": features.keypoints, "descriptors": features.descriptors}
        )
        return features

    def pair(self, a: Features, b: Features) -> VerifiedPair:
        """See `nbv.sparse.matching.verify_pair`."""
        key = digest(self._pair_options, self._key(a), self._key(b))
        if (entry := self._store.get("pairs", key)) is not None:
            return VerifiedPair(entry["matches"], int(entry["config"]))
        pair = self._computed.pair(a, b)
        self._store.put("pairs", key, {"matches": pair.matches, "config": np.array(pair.config)})
        return pair

    def _key(self, features: Features) -> str:
        known = self._keys.get(id(features))
        if known is None:
            known = self._keys[id(features)] = (features, digest(features.keypoints, features.descriptors))
        return known[1]


class CachedSeedModel:
    """The seed model of (rock, replicate): the same for every configuration, so it is built once."""

    def __init__(self, sparse: SparseReconstructor, store: Store) -> None:
        self._sparse, self._store = sparse, store

    def key(self, captures: Sequence[Capture]) -> str:
        """What the seed model of ``captures`` is kept under."""
        images = [capture.image for capture in captures if capture.image is not None]
        return digest(
            STAGE_VERSION, versions()["pycolmap"], dataclasses.asdict(self._sparse.camera),
            canonical(self._sparse.config), self._sparse.target_m, [c.name for c in captures],
            *(capture.camera_from_world for capture in captures), *images,
        )  # fmt: skip

    def bootstrap(self, captures: Sequence[Capture]) -> UpdateReport:
        """See `SparseReconstructor.bootstrap`; a failure is not kept, it is met again."""
        key = self.key(captures)
        with tempfile.TemporaryDirectory(prefix="gatetune-seed-") as folder:
            if (entry := self._store.get("seed_models", key)) is not None:
                for name, data in entry.items():
                    (Path(folder) / name).write_bytes(data.tobytes())
                return self._sparse.load_state(Path(folder), captures)
            report = self._sparse.bootstrap(captures)
            self._sparse.save_state(Path(folder))
            files = {path.name: np.frombuffer(path.read_bytes(), np.uint8) for path in Path(folder).iterdir()}
            self._store.put("seed_models", key, files)
        return report
