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

from nbv.errors import UserError
from nbv.safe_files import (
    RESULT_BYTES,
    json_ready,
    read_json,
    remove,
    to_yaml,
    write_atomic,
)

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

    def write_image(self, name: str, rgb: np.ndarray) -> None:
        """Save an (H, W, 3) uint8 photograph as PNG (Pillow: cv2's PNG writer clashes with pycolmap)."""
        from PIL import Image  # noqa: PLC0415  who looks for a name alone need not wait for it

        buffer = io.BytesIO()
        Image.fromarray(rgb).save(buffer, "PNG", compress_level=1)
        write_atomic(self.root / IMAGES / name, buffer.getbuffer())

    def write_config(self, tree: dict[str, Any], name: str = CONFIG) -> None:
        write_atomic(self.root / name, to_yaml(tree))

    def write_json(self, name: str, value: Any) -> None:
        """Save ``value`` as NAME in the directory's root."""
        write_atomic(self.root / name, json.dumps(json_ready(value), indent=1))

    def append(self, name: str, line: str) -> None:
        """Add one line to a file at once, so that a killed mission leaves its history."""
        with (self.root / name).open("ab") as file:
            file.write(line.encode() + b"\n")


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
