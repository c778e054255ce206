"""The photogrammetric ``Reconstructor``: SIFT and COLMAP in flight, stereo and fusion after it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from nbv.config import MissionConfig, SparseConfig
from nbv.dense import PosedViews, dense_cloud
from nbv.errors import MissionFailure
from nbv.memory import give_back_freed_memory
from nbv.sparse.locating import Located
from nbv.sparse.reconstructor import SparseReconstructor
from nbv.types import Capture, Cloud, PointCloud, SparseModel, UpdateReport

LEAST_BASELINE_ANGLE_DEG = (
    40.0  # of stereo pairs, between the baseline and the line to a target that had to be found
)
FEWEST_SEEDS = 3  # that a model can be aligned by


class PhotogrammetricReconstructor:
    """Sparse model after every capture, dense cloud at the end.

    Implements ``nbv.types.Reconstructor``. Only photographs and the vehicle's telemetry go in.

    Parameters
    ----------
    keep_sparse
        Whether the sparse model can be exported after the dense stage. If not, it is let go once its poses are
        known, with all features and matches, since fusion decides how much memory a mission takes.
    half_extents_m
        Of a box about the target, near whose points alone ``dense.search`` "sparse" seeks depths; by default the crop.
    """

    def __init__(
        self,
        config: MissionConfig,
        *,
        keep_sparse: bool = True,
        half_extents_m: tuple[float, float, float] | None = None,
    ) -> None:
        self._half_extents_m = half_extents_m
        self._config = config
        self._keep_sparse = keep_sparse
        self._sparse: SparseReconstructor | None = self._new_sparse(config.sparse)
        self._images: dict[str, Any] = {}
        self.has_model = False

    def _new_sparse(self, options: SparseConfig) -> SparseReconstructor:
        config = self._config
        return SparseReconstructor(config.camera, options, config.target_m, telemetry=config.telemetry)

    def glimpse(self, captures: Sequence[Capture]) -> SparseModel | None:
        """A model of its own; the photographs' features and pairs serve again at `bootstrap`, if there is a store."""
        few = replace(self._config.sparse, min_registered_seeds=FEWEST_SEEDS)
        try:
            return self._new_sparse(few).bootstrap(captures).model
        except MissionFailure:
            return None

    def bootstrap(self, captures: Sequence[Capture]) -> UpdateReport:
        """The seed model."""
        for capture in captures:
            self._images[capture.name] = capture.image
        try:
            report = self._mapped().bootstrap(captures)
        except MissionFailure:  # it may be asked again, of more photographs
            self._sparse = self._new_sparse(self._config.sparse)
            raise
        self.has_model = True
        return report

    def add(self, capture: Capture) -> UpdateReport:
        """Register, triangulate and adjust one more photograph."""
        self._images[capture.name] = capture.image
        return self._mapped().add(capture)

    def retarget(self, target_m: tuple[float, float, float], half_width_m: float) -> None:
        """Where depths are sought, and the cloud is cut. Pairs are still chosen by where the target was believed.

        Poses that are free of the exact rings bring views one behind the other, whose disparities span thousands of
        pixels: pairs below `LEAST_BASELINE_ANGLE_DEG` took up to 4/5 of what was searched, and added nothing to the cloud.
        """
        least_deg = max(self._config.dense.min_baseline_angle_deg, LEAST_BASELINE_ANGLE_DEG)
        dense = replace(self._config.dense, crop_half_width_m=half_width_m, min_baseline_angle_deg=least_deg)
        self._config = replace(self._config, target_m=target_m, dense=dense)

    def finish(self) -> Cloud:
        """Dense cloud from the registered photographs at the poses that SfM found."""
        self._mapped().refine()
        return self._fuse()

    def _fuse(self) -> PointCloud:
        poses = self._mapped().world_camera_poses()
        points_m = self._mapped().world_points_m() if self._config.dense.search == "sparse" else None
        if points_m is not None and self._half_extents_m is not None:
            inside = np.abs(points_m - self._config.target_m) <= self._half_extents_m
            points_m = points_m[inside.all(axis=1)]
        if not self._keep_sparse:
            self._sparse = None
            give_back_freed_memory()
        images = {name: self._images[name] for name in poses}
        config = self._config
        return dense_cloud(PosedViews(images, poses, config.camera, config.target_m, config.dense), points_m)

    def locate(self, capture: Capture, partners: int) -> Located | None:
        """Where a photograph that is no part of the model was taken; needs ``keep_sparse``."""
        return self._mapped().locate(capture, partners)

    def export_sparse(self, directory: Path, images: Path) -> None:
        """Write the sparse model in COLMAP's format (world frame, metres), coloured by the photographs in ``images``."""
        self._mapped().export(directory, images)

    def _mapped(self) -> SparseReconstructor:
        if self._sparse is None:
            raise ValueError("the sparse model was not kept; ask for keep_sparse")
        return self._sparse
