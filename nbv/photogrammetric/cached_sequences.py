"""The store in front of clouds and metrics, which depend on a whole sequence of photographs.

Which views a mission chooses is a piecewise constant function of its configuration. A mission whose photographs
begin, in order, with those of an earlier mission (same options of the stages) has had the same models after each
of them, and one that ends with them has the same cloud and metrics. So these are kept by a digest of the sequence.

The rule for what is stale is that of ``nbv.cache``.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nbv.cache import Store, address, remember_json
from nbv.config import MissionConfig, SparseConfig
from nbv.evaluation import Evaluation, camera_shell, evaluate_cloud
from nbv.evaluation.evaluate import clean_for_evaluation
from nbv.photogrammetric.cached_sparse import CachedSparse
from nbv.photogrammetric.cached_stages import CachedCorrespondences
from nbv.photogrammetric.reconstructor import PhotogrammetricReconstructor
from nbv.rocks import Rock
from nbv.types import Cloud, Floats, PointCloud


class LazyCloud:
    """A `Cloud` that is made when its points are first asked for.

    A cloud takes 10 to 30 MB, its metrics 4 kB; so only the metrics are kept, and a mission whose metrics are
    known never makes its cloud.

    Parameters
    ----------
    key
        Digest of all that decides the cloud.
    make
        The cloud itself; called at most once. May raise `MissionFailure`.
    """

    def __init__(self, key: str, make: Callable[[], PointCloud]) -> None:
        self.key = key
        self._make = functools.cache(make)

    @property
    def points_m(self) -> Floats:
        """(N, 3) world frame."""
        return self._make().points_m

    @property
    def colors(self) -> NDArray[np.uint8] | None:
        """(N, 3) RGB."""
        return self._make().colors

    @property
    def normals(self) -> Floats | None:
        """(N, 3)."""
        return self._make().normals


class CachedReconstructor(PhotogrammetricReconstructor):
    """`PhotogrammetricReconstructor`; features, pairs, models, and which clouds there are, are kept in ``store``.

    Parameters
    ----------
    config, keep_sparse, half_extents_m
        As in `PhotogrammetricReconstructor`.
    store
        Where they are kept.
    """

    def __init__(
        self,
        config: MissionConfig,
        store: Store,
        *,
        keep_sparse: bool = True,
        half_extents_m: tuple[float, float, float] | None = None,
    ) -> None:
        self._store = store
        super().__init__(config, keep_sparse=keep_sparse, half_extents_m=half_extents_m)

    def _new_sparse(self, options: SparseConfig) -> CachedSparse:
        camera, target_m, telemetry = self._config.camera, self._config.target_m, self._config.telemetry
        source = CachedCorrespondences(camera, self._config.sparse, self._store)
        return CachedSparse(camera, options, target_m, source, telemetry, self._store)

    def finish(self) -> Cloud:
        """See `PhotogrammetricReconstructor.finish`; a cloud that was made before is made if somebody looks at it."""
        self._mapped().refine()
        cloud = LazyCloud(self._cloud_key(), self._fuse)
        if self._store.get("clouds", cloud.key) is None:
            self._store.put("clouds", cloud.key, {"n_points": np.array(len(cloud.points_m))})
        return cloud

    def _cloud_key(self) -> str:
        sparse, config = self._mapped(), self._config
        assert isinstance(sparse, CachedSparse)
        box = [] if self._half_extents_m is None else [self._half_extents_m]
        return address("nbv.dense", sparse.key, config.camera, list(config.target_m), config.dense, *box)


class CachedEvaluation:
    """Metrics by what decides the cloud, the rock and the options; the face of `nbv.evaluation.evaluate_cloud`."""

    def __init__(self, store: Store) -> None:
        self._store = store

    def __call__(self, cloud: Cloud, rock: Rock, config: MissionConfig) -> Evaluation:
        """See `nbv.evaluation.evaluate_cloud`; a failure is not kept, it is met again."""

        made: list[Evaluation] = []

        def evaluate() -> dict[str, Any]:
            made.append(evaluate_cloud(cloud, rock, config, self._store))
            return {"metrics": made[0].metrics, "cleaning": made[0].cleaning}

        inputs = [
            cloud.key if isinstance(cloud, LazyCloud) else cloud.points_m,
            rock.sha256,
            config.evaluation,
            list(config.target_m),
            config.dense.fusion_voxel_m,
            config.telemetry.is_exact,
            config.ground,
            config.scene.ground_seed,
            camera_shell(config),
        ]
        found = remember_json(
            self._store,
            "evaluations",
            evaluate,
            code=__name__,
            inputs=inputs,
        )
        if made:
            return made[0]
        return Evaluation(found["metrics"], found["cleaning"], lambda: clean_for_evaluation(cloud, config)[0])
