"""The photogrammetric ``Reconstructor``: SIFT and COLMAP in flight, stereo and fusion after it, a store in front.

Which views a mission chooses is a piecewise constant function of its configuration. A mission whose photographs
begin, in order, with those of an earlier mission (same options of the stages) has had the same models after each
of them, and one that ends with them has the same cloud and metrics. So these are kept by a digest of the sequence.

What cannot be kept is the mapper itself: COLMAP's hash tables carry the order in which they were filled, that
order reaches the last bits of every later adjustment, and files do not hold it. A mission that leaves a known
sequence is therefore replayed from its seeds before it goes on, at the price that it would have paid anyway.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from nbv.cache import Store, cache_key, digest
from nbv.config import DENSE_BACKENDS, MissionConfig
from nbv.dense.reconstruct import dense_cloud
from nbv.dense.stereo import PosedViews, coarse_depth
from nbv.errors import MissionFailure
from nbv.mission.planning_state import arrays_of, model_of
from nbv.process import Stopwatch, give_back_freed_memory
from nbv.sparse.colmap import export_colmap
from nbv.sparse.features import Correspondences
from nbv.sparse.reconstructor import SparseReconstructor
from nbv.types import Capture, Cloud, LazyCloud, Point, PointCloud, Reconstructor, SparseModel, UpdateReport

# Of stereo pairs, between the baseline and the line to a target that had to be found.
LEAST_BASELINE_ANGLE_DEG = 40.0
_INDICES = ("track_offsets", "track_cameras", "depth_cameras")
FEWEST_SEEDS = 3  # that a model can be aligned by


class PhotogrammetricReconstructor(Reconstructor):
    """Sparse model after every capture, dense cloud at the end.

    As long as the models of the photographs so far are known nothing is reconstructed; what was left out is made up for, photograph
    by photograph as it would have been, as soon as something is asked that the store does not hold.

    ``keep_sparse``: the sparse model can be exported after the dense stage; if not, it is let go once its poses are known, with all
    features and matches, since fusion decides how much memory a mission takes. ``half_extents_m`` are of a box about the target,
    near whose points alone ``dense.search`` "sparse" seeks depths; by default the crop.
    """

    def __init__(
        self,
        config: MissionConfig,
        store: Store | None = None,
        *,
        keep_sparse: bool = True,
        half_extents_m: Point | None = None,
        stopwatch: Stopwatch | None = None,
    ) -> None:
        self._half_extents_m = half_extents_m
        self._config, self._store = config, store
        self._keep_sparse = keep_sparse
        self._images: dict[str, Any] = {}
        self.has_model = False
        source = Correspondences(config, store, stopwatch)
        self._sparse: SparseReconstructor | None = SparseReconstructor(config, source)
        # Not reconstructed yet: the seeds, and what came after them.
        self._seeds: tuple[Capture, ...] = ()
        self._waiting: list[Capture] = []
        self._to_refine = False
        self._key = ""  # of the sequence so far

    def partial_model(self, captures: Sequence[Capture]) -> SparseModel | None:
        """A model of its own; the photographs' features and pairs serve again at `bootstrap`, if there is a store."""
        few = self._config.changed(sparse={"min_registered_seeds": FEWEST_SEEDS})
        other = PhotogrammetricReconstructor(few, self._store)
        try:
            return other.bootstrap(captures).model
        except MissionFailure:
            return None

    def bootstrap(self, captures: Sequence[Capture]) -> UpdateReport:
        self._seeds = tuple(captures)
        self._images.update({capture.name: capture.image for capture in captures})
        self._key = cache_key(
            __name__,
            self._config.camera,
            self._config.sparse,
            self._config.telemetry,
            self._config.target_m,
            [capture.name for capture in captures],
            *(capture.camera_from_world for capture in captures),
            *(capture.image for capture in captures if capture.image is not None),
        )
        report = self._known_report()
        self.has_model = True
        return report

    def add(self, capture: Capture) -> UpdateReport:
        assert capture.image is not None
        self._images[capture.name] = capture.image
        self._waiting.append(capture)
        self._key = digest(self._key, capture.name, capture.camera_from_world, capture.image)
        return self._known_report()

    def recentre(self, target_m: Point, half_width_m: float) -> None:
        """Where depths are sought, and the cloud is cut. Pairs are still chosen by where the target was assumed.

        Poses that are free of the exact rings bring views one behind the other, whose disparities span thousands of
        pixels: pairs below `LEAST_BASELINE_ANGLE_DEG` took up to 4/5 of what was searched, and added nothing to the cloud.
        """
        least_deg = max(self._config.dense.min_baseline_angle_deg, LEAST_BASELINE_ANGLE_DEG)
        dense = {"crop_half_width_m": half_width_m, "min_baseline_angle_deg": least_deg}
        self._config = self._config.changed(target_m=target_m, dense=dense)

    def finish(self) -> Cloud:
        """Dense cloud from the registered photographs at the poses that SfM found.

        Where the store has its metrics, the cloud is computed only if its points are read.
        """
        self._to_refine = True
        cloud = LazyCloud(self._fuse)
        if self._store is None:
            _ = cloud.points_m
        elif self._store.get("clouds", self.cloud_key) is None:
            self._store.put("clouds", self.cloud_key, {"n_points": np.array(len(cloud.points_m))})
        return cloud

    @property
    def cloud_key(self) -> str:
        """Digest of all that decides the cloud."""
        config = self._config
        box = [] if self._half_extents_m is None else [self._half_extents_m]
        more = (*box, *DENSE_BACKENDS.sources(config.dense.backend))
        return cache_key("nbv.dense", self._key, config.camera, list(config.target_m), config.dense, *more)

    def export_sparse(self, directory: Path, images: Path) -> None:
        """Write the sparse model in COLMAP's format (world frame, metres), coloured by the photographs in ``images``."""
        sparse = self._mapped()
        export_colmap(sparse.reconstruction, sparse.alignment.world_from_model, directory, images)

    def _fuse(self) -> PointCloud:
        sparse = self._mapped()
        views = self._views(sparse)
        points_m = sparse.world_points_m() if views.config.search == "sparse" else None
        if points_m is not None and self._half_extents_m is not None:
            inside = np.abs(points_m - views.target_m) <= self._half_extents_m
            points_m = points_m[inside.all(axis=1)]
        if not self._keep_sparse:
            self._sparse = None
            del sparse
            give_back_freed_memory()
        return dense_cloud(views, points_m)

    def _views(self, sparse: SparseReconstructor) -> PosedViews:
        """The registered photographs at the poses that SfM found."""
        poses, config = sparse.world_camera_poses(), self._config
        images = {name: self._images[name] for name in poses}
        return PosedViews(images, poses, config.camera, config.target_m, config.dense)

    def _known_report(self) -> UpdateReport:
        config, key = self._config, self._key
        with_depth = config.plans_on_depth
        if with_depth:
            key = cache_key("nbv.dense", key, config.camera, list(config.target_m), config.dense)
        if self._store is not None and (entry := self._store.get("sequence-models", key)) is not None:
            model = model_of({**entry, **{name: entry[name].astype(np.int64) for name in _INDICES}})
            return UpdateReport(model, bool(entry["registered"]), str(entry["message"]))
        report = self._catch_up()  # a failure is not kept, it is met again
        assert report is not None
        if with_depth:
            assert self._sparse is not None
            depth_m, cameras = coarse_depth(self._views(self._sparse), report.model.points_m)
            report = replace(report, model=replace(report.model, depth_m=depth_m, depth_cameras=cameras))
        if self._store is not None:
            arrays = arrays_of(report.model)
            for name in _INDICES:  # in the smallest type that holds them
                arrays[name] = arrays[name].astype(np.min_scalar_type(int(arrays[name].max(initial=0))))
            told = {"registered": np.array(report.registered), "message": np.array(report.message)}
            self._store.put("sequence-models", key, {**arrays, **told})
        return report

    def _mapped(self) -> SparseReconstructor:
        """The sparse model of all photographs so far."""
        self._catch_up()
        assert self._sparse is not None
        return self._sparse

    def _catch_up(self) -> UpdateReport | None:
        """Reconstruct what was left out, and report on the last photograph of it."""
        sparse, report = self._sparse, None
        assert sparse is not None
        if self._seeds:
            seeds, self._seeds = self._seeds, ()
            report = sparse.bootstrap(seeds)
        while self._waiting:
            report = sparse.add(self._waiting.pop(0))
        if self._to_refine:
            self._to_refine = False
            sparse.refine()
        return report
