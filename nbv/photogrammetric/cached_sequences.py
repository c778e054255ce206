"""The store in front of what depends on a whole sequence of photographs: sparse models, clouds, metrics.

Which views a mission chooses is a piecewise constant function of its configuration. A mission whose photographs
begin, in order, with those of an earlier mission (same options of the stages) has had the same models after each
of them, and one that ends with them has the same cloud and metrics. So these are kept by a digest of the sequence.

What cannot be kept is the mapper itself: COLMAP's hash tables carry the order in which they were filled, that
order reaches the last bits of every later adjustment, and files do not hold it. A mission that leaves a known
sequence is therefore replayed from its seed model before it goes on, at the price that it would have paid anyway.

The rule for what is stale is that of ``nbv.cache``.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nbv.cache import Arrays, Store, address, digest, holds, remember_json
from nbv.config import MissionConfig
from nbv.errors import MissionFailure
from nbv.evaluation import Evaluation, camera_shell, evaluate_cloud
from nbv.evaluation.evaluate import clean_for_evaluation
from nbv.photogrammetric.cached_stages import CachedSeedModel
from nbv.rocks import Rock
from nbv.sparse.reconstructor import SparseReconstructor
from nbv.types import Capture, Cloud, Floats, PointCloud, SparseModel, UpdateReport


class CachedSparse:
    """The model after each photograph, by the photographs so far; the face of a `SparseReconstructor`.

    As long as the models are known the reconstructor behind does nothing. It is brought up to date, photograph
    by photograph as it would have been, as soon as something is asked that the store does not hold.
    """

    def __init__(self, sparse: SparseReconstructor, store: Store) -> None:
        self._sparse, self._store = sparse, store
        self._seed_stage = CachedSeedModel(sparse, store)
        self._seeds: tuple[Capture, ...] | None = None  # not given to the reconstructor yet
        self._waiting: list[Capture] = []  # likewise
        self._to_refine = False
        self.key = ""  # of the sequence so far

    def bootstrap(self, captures: Sequence[Capture]) -> UpdateReport:
        """See `SparseReconstructor.bootstrap`."""
        self._seeds = tuple(captures)
        self.key = self._seed_stage.key(captures)
        return self._report()

    def add(self, capture: Capture) -> UpdateReport:
        """See `SparseReconstructor.add`."""
        assert capture.image is not None
        self._waiting.append(capture)
        self.key = digest(self.key, capture.name, capture.camera_from_world, capture.image)
        return self._report()

    def refine(self) -> None:
        """See `SparseReconstructor.refine`."""
        self._to_refine = True

    def world_camera_poses(self) -> dict[str, Floats]:
        """See `SparseReconstructor.world_camera_poses`."""
        self._catch_up()
        return self._sparse.world_camera_poses()

    def world_points_m(self) -> Floats:
        """See `SparseReconstructor.world_points_m`."""
        self._catch_up()
        return self._sparse.world_points_m()

    def export(self, path: Path) -> None:
        """See `SparseReconstructor.export`."""
        self._catch_up()
        self._sparse.export(path)

    def let_go(self) -> None:
        """Forget the reconstructor and all that it holds; of the sequence only ``key`` remains."""
        del self._sparse, self._seed_stage

    def _report(self) -> UpdateReport:
        if (entry := self._store.get("sequence-models", self.key, _is_report)) is not None:
            return _unpack_report(entry)
        report = self._catch_up()  # a failure is not kept, it is met again
        assert report is not None
        self._store.put("sequence-models", self.key, _pack_report(report))
        return report

    def _catch_up(self) -> UpdateReport | None:
        """Give the reconstructor what it has not seen; its last report, with the seconds of all."""
        reports = []
        if self._seeds is not None:
            seeds, self._seeds = self._seeds, None
            reports.append(self._seed_stage.bootstrap(seeds))
        while self._waiting:
            reports.append(self._sparse.add(self._waiting.pop(0)))
        if self._to_refine:
            self._to_refine = False
            reports.append(self._sparse.refine())
        if not reports:
            return None
        seconds: dict[str, float] = {}
        for report in reports:
            for stage, value in report.timings_s.items():
                seconds[stage] = seconds.get(stage, 0.0) + value
        return dataclasses.replace(reports[-1], timings_s=seconds)


class LazyCloud:
    """A `Cloud` that is made when its points are first asked for.

    A cloud takes 10 to 30 MB, its metrics 4 kB; so only the metrics are kept, and a mission whose metrics are
    known never makes its cloud.

    Parameters
    ----------
    key
        Digest of all that decides the cloud.
    n_points
        How many points it has.
    make
        The cloud itself; called at most once.
    """

    def __init__(self, key: str, n_points: int, make: Callable[[], PointCloud]) -> None:
        self.key = key
        self._n_points = n_points
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

    def __len__(self) -> int:
        return self._n_points


class CachedClouds:
    """Which sequences of photographs have been fused, with which options, and to how many points.

    The cloud of a known sequence is made only if somebody looks at its points (`LazyCloud`); that there is no
    cloud is known at once.

    Parameters
    ----------
    make
        The cloud at a number of agreeing views (None: the configured one); may raise `MissionFailure`.
    """

    def __init__(
        self,
        make: Callable[[int | None], PointCloud],
        sparse: CachedSparse,
        config: MissionConfig,
        store: Store,
    ) -> None:
        self._make, self._sparse, self._config, self._store = make, sparse, config, store

    def retarget(self, config: MissionConfig) -> None:
        """From now on clouds are cut about the target of ``config``."""
        self._config = config

    def __call__(self, agreeing_views: int | None = None) -> LazyCloud:
        """The cloud, or the `MissionFailure` that there is none."""
        config = self._config
        level = config.dense.agreeing_views if agreeing_views is None else agreeing_views
        # Depths are checked with the configured number and may then be fused at a stricter one: the same bits.
        dense = dataclasses.replace(config.dense, agreeing_views=level)
        key = address("nbv.dense", self._sparse.key, config.camera, list(config.target_m), dense)
        if (entry := self._store.get("clouds", key, _is_known_cloud)) is not None:
            if "failure" in entry:
                raise MissionFailure(*(str(part) for part in entry["failure"]))
            return LazyCloud(key, int(entry["n_points"]), lambda: self._make(agreeing_views))
        try:
            cloud = self._make(agreeing_views)
        except MissionFailure as failure:
            self._store.put("clouds", key, {"failure": np.array([failure.reason, failure.message])})
            raise
        self._store.put("clouds", key, {"n_points": np.array(len(cloud))})
        return LazyCloud(key, len(cloud), lambda: cloud)


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
            is_sound=_is_evaluation,
            code="nbv.evaluation",
            inputs=inputs,
        )
        if made:
            return made[0]
        return Evaluation(found["metrics"], found["cleaning"], lambda: clean_for_evaluation(cloud, config)[0])


def _pack_report(report: UpdateReport) -> Arrays:
    model = report.model
    return {
        "points_m": model.points_m,
        "reprojection_error_px": model.reprojection_error_px,
        "track_lengths": _smallest(model.track_lengths),
        "track_cameras": _smallest(model.track_cameras),
        "camera_centers_m": model.camera_centers_m,
        "camera_names": np.array(model.camera_names),
        "alignment_m": np.array([model.alignment_rms_m, model.alignment_max_m]),
        "registered": np.array(report.registered),
        "message": np.array(report.message),
    }


_HAS_REPORT = holds(
    {
        "points_m": "f n 3",
        "reprojection_error_px": "f n",
        "track_lengths": "u n",
        "track_cameras": "u _ <c",
        "camera_centers_m": "f c 3",
        "camera_names": "U c",
        "alignment_m": "f 2",
        "registered": "b",
        "message": "U",
    }
)
_IS_CLOUD, _IS_FAILURE = holds({"n_points": "i"}), holds({"failure": "U 2"})


def _is_report(entry: Arrays) -> bool:
    return _HAS_REPORT(entry) and int(entry["track_lengths"].sum()) == len(entry["track_cameras"])


def _is_known_cloud(entry: Arrays) -> bool:
    return _IS_CLOUD(entry) or _IS_FAILURE(entry)


def _is_evaluation(tree: Any) -> bool:
    return isinstance(tree, dict) and all(isinstance(tree.get(k), dict) for k in ("metrics", "cleaning"))


def _unpack_report(entry: Arrays) -> UpdateReport:
    offsets = np.zeros(len(entry["track_lengths"]) + 1, dtype=np.int64)
    np.cumsum(entry["track_lengths"], out=offsets[1:])
    model = SparseModel(
        points_m=entry["points_m"],
        reprojection_error_px=entry["reprojection_error_px"],
        track_offsets=offsets,
        track_cameras=entry["track_cameras"].astype(np.int64),
        camera_centers_m=entry["camera_centers_m"],
        camera_names=tuple(str(name) for name in entry["camera_names"]),
        alignment_rms_m=float(entry["alignment_m"][0]),
        alignment_max_m=float(entry["alignment_m"][1]),
    )
    return UpdateReport(model, bool(entry["registered"]), str(entry["message"]))


def _smallest(values: np.ndarray) -> np.ndarray:
    """The same non-negative integers in the smallest type that holds them."""
    return values.astype(np.min_scalar_type(int(values.max(initial=0))))
