"""The store in front of sparse models, which depend on a whole sequence of photographs.

What cannot be kept is the mapper itself: COLMAP's hash tables carry the order in which they were filled, that
order reaches the last bits of every later adjustment, and files do not hold it. A mission that leaves a known
sequence is therefore replayed from its seed model before it goes on, at the price that it would have paid anyway.

The key of an entry covers this module, too: it decides which arrays an entry has.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from nbv.cache import Arrays, Store, address, digest
from nbv.config import CameraConfig, SparseConfig, TelemetryConfig
from nbv.mission.planning_state import arrays_of, model_of
from nbv.sparse.correspondences import Correspondences
from nbv.sparse.locating import Located
from nbv.sparse.reconstructor import SparseReconstructor
from nbv.types import Capture, Floats, UpdateReport


class CachedSparse(SparseReconstructor):
    """The model after each photograph, by the photographs so far.

    As long as the models are known nothing is reconstructed. What was left out is made up for, photograph by
    photograph as it would have been, as soon as something is asked that the store does not hold.

    Parameters
    ----------
    camera, config, target_m, correspondences, telemetry
        As in `SparseReconstructor`.
    store
        Where models are kept, with the seed model's files.
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
            __name__,
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


def _pack_report(report: UpdateReport) -> Arrays:
    arrays = arrays_of(report.model)
    for name in ("track_offsets", "track_cameras"):  # in the smallest type that holds them
        arrays[name] = arrays[name].astype(np.min_scalar_type(int(arrays[name].max(initial=0))))
    return {**arrays, "registered": np.array(report.registered), "message": np.array(report.message)}


def _unpack_report(entry: Arrays) -> UpdateReport:
    indices = {name: entry[name].astype(np.int64) for name in ("track_offsets", "track_cameras")}
    return UpdateReport(model_of({**entry, **indices}), bool(entry["registered"]), str(entry["message"]))
