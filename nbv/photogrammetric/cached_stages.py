"""The store in front of photographs, features, pairs and the seed model; the rule is that of ``nbv.cache``.

Each wrapper has the face of what it wraps, so a mission with a store and one without give the same bits.
"""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from nbv.cache import Arrays, Store, address, digest, holds, remember
from nbv.config import CameraConfig, MissionConfig, SparseConfig
from nbv.errors import UserError
from nbv.photogrammetric.studio import Studio
from nbv.rocks import Rock
from nbv.sparse.correspondences import ComputedCorrespondences
from nbv.sparse.features import DESCRIPTOR_SIZE, Features
from nbv.sparse.matching import VerifiedPair
from nbv.sparse.reconstructor import SparseReconstructor
from nbv.types import Capture, Floats, UpdateReport, Viewpoint

_STUDIO, _FEATURES, _PAIRS = "nbv.photogrammetric.studio", "nbv.sparse.features", "nbv.sparse.matching"
_SPARSE, _GROUND = "nbv.sparse", "nbv.sparse.ground_features"
_ARE_FEATURES = holds({"keypoints": "f k 4", "descriptors": f"u k {DESCRIPTOR_SIZE}"})
_IS_PAIR = holds({"matches": "u _ 2", "config": "i"})


class CachedStudio:
    """Photographs by rock, replicate, viewpoint, pose and all of the configuration that they depend on."""

    def __init__(
        self, studio: Studio, store: Store, rock: Rock, replicate: int, config: MissionConfig
    ) -> None:
        self._studio, self._store = studio, store
        world = (config.camera, config.scene, config.sensor, config.ground, config.target_m)
        self._identity = (rock.sha256, replicate, *world)
        self._is_photograph = holds({"image": f"u {config.camera.height_px} {config.camera.width_px} 3"})

    def take_photograph(self, viewpoint: Viewpoint, position_m: Floats, time_s: float) -> Capture:
        """See `nbv.types.Camera`."""
        reported = self._studio.aim(position_m)
        true = self._studio.true_pose(reported, viewpoint, time_s)
        entry = remember(
            self._store,
            "photographs",
            lambda: {"image": self._studio.photograph(viewpoint, true)},
            is_sound=self._is_photograph,
            code=_STUDIO,
            inputs=[*self._identity, viewpoint.id, true],
        )
        return Capture(f"{viewpoint.id}.png", viewpoint, reported, entry["image"])

    def aim_at(self, target_m: tuple[float, float, float]) -> None:
        """See `nbv.types.Camera`."""
        self._studio.aim_at(target_m)

    def close(self) -> None:
        """See `nbv.photogrammetric.studio.Studio.close`."""
        self._studio.close()


class CachedCorrespondences:
    """Features by pixels and options; verified pairs by the two feature sets and options."""

    def __init__(self, camera: CameraConfig, config: SparseConfig, store: Store) -> None:
        self._computed = ComputedCorrespondences(camera, config)
        self.timer = self._computed.timer
        self._store = store
        self._feature_options = [config.max_features, config.first_octave, config.peak_threshold]
        self._ground_options = [camera, config.ground_features, config.peak_threshold]
        self._pair_options = [camera, config.match_ratio, config.min_inliers, config.min_ransac_trials]
        self._digests: dict[int, tuple[Features, str]] = {}  # holds the features, so that ids stay theirs

    def features(self, image: NDArray[np.uint8]) -> Features:
        """See `nbv.sparse.features.extract_features`."""

        def extract() -> Arrays:
            features = self._computed.features(image)
            return {"keypoints": features.keypoints, "descriptors": features.descriptors}

        inputs = [*self._feature_options, image]
        entry = remember(
            self._store, "features", extract, is_sound=_ARE_FEATURES, code=_FEATURES, inputs=inputs
        )
        return Features(entry["keypoints"], entry["descriptors"])

    def ground_features(
        self, image: NDArray[np.uint8], camera_from_world: Floats, target_m: Floats
    ) -> Features:
        """See `nbv.sparse.ground_features.extract_ground_features`."""

        def extract() -> Arrays:
            features = self._computed.ground_features(image, camera_from_world, target_m)
            return {"keypoints": features.keypoints, "descriptors": features.descriptors}

        inputs = [*self._ground_options, image, camera_from_world, target_m]
        entry = remember(
            self._store, "features", extract, is_sound=_ARE_FEATURES, code=_GROUND, inputs=inputs
        )
        return Features(entry["keypoints"], entry["descriptors"])

    def pair(self, a: Features, b: Features) -> VerifiedPair:
        """See `nbv.sparse.matching.verify_pair`."""

        def verify() -> Arrays:
            pair = self._computed.pair(a, b)
            return {"matches": pair.matches, "config": np.array(pair.config)}

        def is_sound(entry: Arrays) -> bool:
            return _IS_PAIR(entry) and bool((entry["matches"] < [[len(a), len(b)]]).all())

        inputs = [*self._pair_options, self._digest(a), self._digest(b)]
        if a.n_ground or b.n_ground:
            inputs += [a.n_ground, b.n_ground]
        entry = remember(self._store, "pairs", verify, is_sound=is_sound, code=_PAIRS, inputs=inputs)
        return VerifiedPair(entry["matches"], int(entry["config"]))

    def _digest(self, features: Features) -> str:
        known = self._digests.get(id(features))
        if known is None:
            found = digest(features.keypoints, features.descriptors)
            known = self._digests[id(features)] = (features, found)
        return known[1]


def _are_files(entry: Arrays) -> bool:
    layout = dict.fromkeys(entry, "u _")
    return holds(layout)(entry) and all(Path(name).name == name for name in entry)


class CachedSeedModel:
    """The seed model of (rock, replicate): the same for every configuration, so it is built once."""

    def __init__(self, sparse: SparseReconstructor, store: Store) -> None:
        self._sparse, self._store = sparse, store

    def key(self, captures: Sequence[Capture]) -> str:
        """What the seed model of ``captures`` is kept under."""
        images = [capture.image for capture in captures if capture.image is not None]
        sparse = self._sparse
        return address(
            _SPARSE,
            sparse.camera,
            sparse.config,
            sparse.telemetry,
            sparse.target_m,
            [capture.name for capture in captures],
            *(capture.camera_from_world for capture in captures),
            *images,
        )

    def bootstrap(self, captures: Sequence[Capture]) -> UpdateReport:
        """See `SparseReconstructor.bootstrap`; a failure is not kept, it is met again."""
        key = self.key(captures)
        with tempfile.TemporaryDirectory(prefix="gatetune-seed-") as folder:
            if (entry := self._store.get("seed-models", key, _are_files)) is not None:
                for name, data in entry.items():
                    (Path(folder) / name).write_bytes(data.tobytes())
                with contextlib.suppress(UserError):  # not what its name says: built and kept anew
                    return self._sparse.load_state(Path(folder), captures)
                for path in Path(folder).iterdir():
                    path.unlink()
            report = self._sparse.bootstrap(captures)
            self._sparse.save_state(Path(folder))
            files = {path.name: np.frombuffer(path.read_bytes(), np.uint8) for path in Path(folder).iterdir()}
            self._store.put("seed-models", key, files)
        return report
