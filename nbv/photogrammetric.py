"""The photogrammetric ``Reconstructor``: SIFT and COLMAP in flight, stereo and fusion after it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from nbv.config import MissionConfig
from nbv.dense import reconstruct_dense
from nbv.sparse import SparseReconstructor
from nbv.types import Capture, PointCloud, UpdateReport


class PhotogrammetricReconstructor:
    """Sparse model after every capture, dense cloud at the end.

    Implements ``nbv.types.Reconstructor``. Only photographs and the vehicle's telemetry go in.
    """

    def __init__(self, config: MissionConfig) -> None:
        self._config = config
        self._sparse = SparseReconstructor(config.sparse, config.camera, config.target_m)
        self._images: dict[str, Any] = {}
        self.dense_report: Any = None

    def bootstrap(self, captures: Sequence[Capture]) -> UpdateReport:
        """The seed model."""
        for capture in captures:
            self._images[capture.name] = capture.image
        return self._sparse.bootstrap(captures)

    def add(self, capture: Capture) -> UpdateReport:
        """Register, triangulate and adjust one more photograph."""
        self._images[capture.name] = capture.image
        return self._sparse.add(capture)

    def finish(self) -> PointCloud:
        """Dense cloud from the registered photographs at the poses that SfM found."""
        poses = self._sparse.world_camera_poses()
        images = {name: self._images[name] for name in poses}
        cloud, self.dense_report = reconstruct_dense(
            images, poses, self._config.camera, self._config.target_m, self._config.dense
        )
        return cloud

    def export_sparse(self, directory: Path) -> None:
        """Write the sparse model in COLMAP's format (world frame, metres)."""
        self._sparse.export(directory)
