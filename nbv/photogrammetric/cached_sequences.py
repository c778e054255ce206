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

from nbv.cache import Arrays, Store, address, digest, remember_json
from nbv.config import CameraConfig, MissionConfig, SparseConfig, TelemetryConfig
from nbv.evaluation import Evaluation, camera_shell, evaluate_cloud
from nbv.evaluation.evaluate import clean_for_evaluation
from nbv.mission.planning_state import arrays_of, model_of
from nbv.photogrammetric.cached_stages import CachedCorrespondences
from nbv.photogrammetric.reconstructor import PhotogrammetricReconstructor
from nbv.rocks import Rock
from nbv.sparse.correspondences import Correspondences
from nbv.sparse.locating import Located
from nbv.sparse.reconstructor import SparseReconstructor
from nbv.types import Capture, Cloud, Floats, PointCloud, UpdateReport


class CachedSparse(SparseReconstructor):
    """The model after each photograph, by the photographs so far.

    As long as the models are known nothing is reconstructed. What was left out is made up for, photograph by
    photograph as it would have been, as soon as something is asked that the store does not hold.
    """

    def __init__(
        self,
        camera: CameraConfig,
        config: SparseConfig,
        target_m: Sequence[float],
        correspondences: Correspondences,
        telemetry: TelemetryConfig,
        store: Store,
    ) -> None:
        super().__init__(camera, config, target_m, correspondences, telemetry)
        self._store = store
        self._seeds: tuple[Capture, ...] | None = None  # not reconstructed yet
        self._seed_key = ""
        self._waiting: list[Capture] = []  # likewise
        self._to_refine = False
        self.key = ""  # of the sequence so far

    def bootstrap(self, captures: Sequence[Capture]) -> UpdateReport:
        """See `SparseReconstructor.bootstrap`."""
        self._seeds = tuple(captures)
        self.key = address(
            "nbv.sparse",
            self.camera,
            self.config,
            self.telemetry,
            self.target_m,
            [capture.name for capture in captures],
            *(capture.camera_from_world for capture in captures),
            *(capture.image for capture in captures if capture.image is not None),
        )
        self._seed_key = self.key
        return self._known_report()

    def add(self, capture: Capture) -> UpdateReport:
        """See `SparseReconstructor.add`."""
        assert capture.image is not None
        self._waiting.append(capture)
        self.key = digest(self.key, capture.name, capture.camera_from_world, capture.image)
        return self._known_report()

    def refine(self) -> None:  # type: ignore[override]  # nobody asks for this report
        """See `SparseReconstructor.refine`."""
        self._to_refine = True

    def world_camera_poses(self) -> dict[str, Floats]:
        """See `SparseReconstructor.world_camera_poses`."""
        self._catch_up()
        return super().world_camera_poses()

    def world_points_m(self) -> Floats:
        """See `SparseReconstructor.world_points_m`."""
        self._catch_up()
        return super().world_points_m()

    def locate(self, capture: Capture, partners: int) -> Located | None:
        """See `SparseReconstructor.locate`."""
        self._catch_up()
        return super().locate(capture, partners)

    def export(self, directory: Path, images: Path) -> None:
        """See `SparseReconstructor.export`."""
        self._catch_up()
        super().export(directory, images)

    def _known_report(self) -> UpdateReport:
        if (entry := self._store.get("sequence-models", self.key)) is not None:
            return _unpack_report(entry)
        report = self._catch_up()  # a failure is not kept, it is met again
        assert report is not None
        self._store.put("sequence-models", self.key, _pack_report(report))
        return report

    def _catch_up(self) -> UpdateReport | None:
        """Reconstruct what was left out; the last report, with the seconds of all."""
        reports = []
        if self._seeds is not None:
            seeds, self._seeds = self._seeds, None
            reports.append(self._seed_model(seeds))
        while self._waiting:
            reports.append(super().add(self._waiting.pop(0)))
        if self._to_refine:
            self._to_refine = False
            reports.append(super().refine())
        if not reports:
            return None
        seconds: dict[str, float] = {}
        for report in reports:
            for stage, value in report.timings_s.items():
                seconds[stage] = seconds.get(stage, 0.0) + value
        return dataclasses.replace(reports[-1], timings_s=seconds)

    def _seed_model(self, captures: Sequence[Capture]) -> UpdateReport:
        """`SparseReconstructor.bootstrap`; of many missions on one (rock, replicate) it is the same, so it is kept."""
        if (entry := self._store.get("seed-models", self._seed_key)) is not None:
            return self.bootstrap_from(captures, {name: data.tobytes() for name, data in entry.items()})
        report = super().bootstrap(captures)
        files = {name: np.frombuffer(content, np.uint8) for name, content in self.seed_files().items()}
        self._store.put("seed-models", self._seed_key, files)
        return report


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
    """`PhotogrammetricReconstructor`; features, pairs, models, and which clouds there are, are kept in ``store``."""

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
            code="nbv.evaluation",
            inputs=inputs,
        )
        if made:
            return made[0]
        return Evaluation(found["metrics"], found["cleaning"], lambda: clean_for_evaluation(cloud, config)[0])


def _pack_report(report: UpdateReport) -> Arrays:
    arrays = arrays_of(report.model)
    for name in ("track_offsets", "track_cameras"):  # in the smallest type that holds them
        arrays[name] = arrays[name].astype(np.min_scalar_type(int(arrays[name].max(initial=0))))
    return {**arrays, "registered": np.array(report.registered), "message": np.array(report.message)}


def _unpack_report(entry: Arrays) -> UpdateReport:
    indices = {name: entry[name].astype(np.int64) for name in ("track_offsets", "track_cameras")}
    return UpdateReport(model_of({**entry, **indices}), bool(entry["registered"]), str(entry["message"]))
