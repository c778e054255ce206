"""The store in front of photographs, features and pairs; the rule is that of ``nbv.cache``.

Each class has the face of what it stands in front of, so a mission with a store and one without give the same bits.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from nbv.cache import Arrays, Store, remember
from nbv.config import CameraConfig, MissionConfig, SparseConfig
from nbv.photogrammetric.studio import Studio
from nbv.rocks import Rock
from nbv.scene import Renderer
from nbv.sparse.correspondences import Correspondences
from nbv.sparse.features import Features
from nbv.sparse.matching import VerifiedPair
from nbv.types import Floats, Viewpoint


class CachedStudio(Studio):
    """Photographs by rock, replicate, viewpoint, pose and all of the configuration that they depend on.

    Parameters
    ----------
    make_renderer, rock, replicate, config
        As in `Studio`.
    store
        Where photographs are kept.
    """

    def __init__(
        self,
        make_renderer: Callable[[CameraConfig], Renderer],
        rock: Rock,
        replicate: int,
        config: MissionConfig,
        store: Store,
    ) -> None:
        super().__init__(make_renderer, rock, replicate, config)
        self._store = store
        world = (config.camera, config.scene, config.sensor, config.ground, config.target_m)
        self._identity = (rock.sha256, replicate, *world)

    def photograph(self, viewpoint: Viewpoint, true_pose: Floats) -> NDArray[np.uint8]:
        """See `Studio.photograph`."""
        photograph = super().photograph
        return remember(
            self._store,
            "photographs",
            lambda: {"image": photograph(viewpoint, true_pose)},
            code=Studio.__module__,
            inputs=[*self._identity, viewpoint.id, true_pose],
        )["image"]


class CachedCorrespondences(Correspondences):
    """Features by pixels and options; verified pairs by the two feature sets and options."""

    def __init__(self, camera: CameraConfig, config: SparseConfig, store: Store) -> None:
        super().__init__(camera, config)
        self._store = store
        self._feature_options = [config.max_features, config.first_octave, config.peak_threshold]
        self._ground_options = [camera, config.ground_features, config.peak_threshold]
        self._pair_options = [camera, config.match_ratio, config.min_inliers, config.min_ransac_trials]

    def features(self, image: NDArray[np.uint8]) -> Features:
        """See `Correspondences.features`."""
        extract = super().features
        return self._features(lambda: extract(image), "nbv.sparse.features", [*self._feature_options, image])

    def ground_features(
        self, image: NDArray[np.uint8], camera_from_world: Floats, target_m: Floats
    ) -> Features:
        """See `Correspondences.ground_features`."""
        extract = super().ground_features
        inputs = [*self._ground_options, image, camera_from_world, target_m]
        return self._features(
            lambda: extract(image, camera_from_world, target_m), "nbv.sparse.ground_features", inputs
        )

    def _features(self, extract: Callable[[], Features], code: str, inputs: list[object]) -> Features:
        def make() -> Arrays:
            features = extract()
            return {"keypoints": features.keypoints, "descriptors": features.descriptors}

        entry = remember(self._store, "features", make, code=code, inputs=inputs)
        return Features(entry["keypoints"], entry["descriptors"])

    def pair(self, a: Features, b: Features) -> VerifiedPair:
        """See `Correspondences.pair`."""
        verify = super().pair

        def make() -> Arrays:
            pair = verify(a, b)
            return {"matches": pair.matches, "config": np.array(pair.config)}

        inputs = [*self._pair_options, a.digest, b.digest]
        code = "nbv.sparse.matching"
        entry = remember(self._store, "pairs", make, code=code, inputs=inputs)
        return VerifiedPair(entry["matches"], int(entry["config"]))
