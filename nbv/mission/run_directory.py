"""The one owner of a mission directory's layout.

::

    config.yaml            the complete configuration
    located.yaml           the same with the target as the vehicle is told of it, then as it found it, where that is another
    images/NAME.png        every photograph
    progress.txt           while it runs: a line ``12/32`` per photograph taken
    trace.jsonl            one line per adaptive capture, written as it happens
    states/iter_NN.npz     the planning state of every iteration (``gatetune mission explain``)
    sparse/0/              the final sparse model in COLMAP's format and as points.ply, world frame, metres
    dense.ply cleaned.ply  the fused cloud before and after cleaning
    flight.json            legs with their trajectories
    cleaning.json          what the cleaning took off the dense cloud
    mission.json           the result with metrics and provenance; written last, atomically: its presence means "finished"
    worker.log             what the mission printed, where the tuner ran it
"""

from __future__ import annotations

import io
import json
from pathlib import Path
from typing import Any

import numpy as np

from nbv.convert import json_ready
from nbv.errors import UserError
from nbv.safe_files import (
    RESULT_BYTES,
    read_json,
    remove,
    require_whole,
    to_yaml,
    write_atomic,
)
from nbv.types import Cloud, PointCloud

CONFIG, LOCATED, RESULT = "config.yaml", "located.yaml", "mission.json"
PROGRESS, TRACE, WORKER_LOG = "progress.txt", "trace.jsonl", "worker.log"
IMAGES, STATES, SPARSE_MODEL = "images", "states", "sparse/0"
DENSE, CLEANED, CLEANING, FLIGHT = "dense.ply", "cleaned.ply", "cleaning.json", "flight.json"
_FILES = (PROGRESS, TRACE, LOCATED, DENSE, CLEANED, CLEANING, FLIGHT)
_REMOVED_AT_START = (RESULT, IMAGES, STATES, "sparse", *_FILES)


class RunDirectory:
    """Paths and writers of one mission's directory.

    `UserError` where the directory cannot be written, or already holds a finished mission.
    """

    def __init__(self, root: Path, *, overwrite: bool = False) -> None:
        self.root = root
        if (root / RESULT).exists() and not overwrite:
            raise UserError(
                f"{root} already holds a finished mission; choose another --out or pass --overwrite"
            )
        try:
            root.mkdir(parents=True, exist_ok=True)
            for name in _REMOVED_AT_START:
                remove(root / name)
            (root / IMAGES).mkdir()
            (root / STATES).mkdir()
        except OSError as error:
            raise UserError(f"cannot write to {root}: {error.strerror}; choose another directory") from error

    @property
    def images(self) -> Path:
        return self.root / IMAGES

    def write_image(self, name: str, rgb: np.ndarray) -> None:
        """Save an (H, W, 3) uint8 photograph as PNG (Pillow: cv2's PNG writer clashes with pycolmap)."""
        from PIL import Image  # noqa: PLC0415  who looks for a name alone need not wait for it

        buffer = io.BytesIO()
        Image.fromarray(rgb).save(buffer, "PNG", compress_level=1)
        write_atomic(self.images / name, buffer.getbuffer())

    def write_config(self, tree: dict[str, Any], name: str = CONFIG) -> None:
        write_atomic(self.root / name, to_yaml(tree))

    def write_json(self, name: str, value: Any) -> None:
        """Save ``value`` as NAME in the directory's root."""
        write_atomic(self.root / name, json.dumps(json_ready(value), indent=1))

    def append(self, name: str, line: str) -> None:
        """Add one line to a file at once, so that a killed mission leaves its history."""
        with (self.root / name).open("ab") as file:
            file.write(line.encode() + b"\n")

    @property
    def sparse_model(self) -> Path:
        return self.root / SPARSE_MODEL


def state_file(run: Path, iteration: int) -> Path:
    return run / STATES / f"iter_{iteration:02d}.npz"


def state_files(run: Path) -> list[Path]:
    """The saved states in the order of their numbers."""
    return sorted((run / STATES).glob("iter_*.npz"), key=lambda path: (len(path.name), path.name))


def read_result(run: Path) -> dict[str, Any]:
    """The tree in a mission's ``mission.json``, whichever kind of mission wrote it.

    `UserError` where the file cannot be read, or is no mapping.
    """
    file = run / RESULT
    tree = read_json(file, RESULT_BYTES)
    if not isinstance(tree, dict):
        raise UserError(f"{file} is not a mission result; restore it")
    return tree


def write_ply(path: Path, cloud: Cloud) -> None:
    """Binary PLY with float32 positions, and normals and 8-bit colours where there are any."""
    import open3d as o3d  # noqa: PLC0415  seconds to load

    def tensor(values: np.ndarray, dtype: type) -> o3d.core.Tensor:
        return o3d.core.Tensor.from_numpy(np.array(values, dtype, order="C"))

    table = o3d.t.geometry.PointCloud(tensor(cloud.points_m, np.float32))
    if cloud.normals is not None:
        table.point.normals = tensor(cloud.normals, np.float32)
    if cloud.colors is not None:
        table.point.colors = tensor(cloud.colors, np.uint8)
    o3d.t.io.write_point_cloud(path, table)
    require_whole(path)


def read_ply(path: Path) -> PointCloud:
    """Read a point cloud that ``write_ply`` wrote (or any PLY that Open3D reads)."""
    import open3d as o3d  # noqa: PLC0415  seconds to load

    if not path.is_file():
        raise UserError(f"{path} does not exist")
    cloud = o3d.io.read_point_cloud(path)
    colors = np.asarray(cloud.colors)
    return PointCloud(
        np.asarray(cloud.points, dtype=float),
        (colors * 255 + 0.5).astype(np.uint8) if len(colors) else None,
        np.asarray(cloud.normals, dtype=float) if cloud.has_normals() else None,
    )
