"""The dense reference of a set as a PLY file that viewers open and this program reads back with checks."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from nbv.errors import UserError
from nbv.safe_files import read_bytes
from nbv.types import Floats, PointCloud

MAX_REFERENCE_BYTES = 2**30
_RECORD = np.dtype(
    [
        *((name, "<f4") for name in ("x", "y", "z", "nx", "ny", "nz")),
        *((name, "u1") for name in ("red", "green", "blue")),
        ("error", "<f4"),
    ]
)
_PLY_TYPES = {"<f4": "float", "|u1": "uchar"}


@dataclass(frozen=True)
class Reference:
    """The dense cloud made of all registered photographs, in the set's frame."""

    points_m: Floats  # (N, 3)
    normals: Floats  # (N, 3) unit
    colors: NDArray[np.uint8]  # (N, 3) RGB
    error_m: Floats  # (N,) distance to the cloud of the worse half of the photographs

    def __len__(self) -> int:
        return len(self.points_m)

    @property
    def cloud(self) -> PointCloud:
        """Its points as any other cloud."""
        return PointCloud(self.points_m, self.colors, self.normals)


def write_reference(reference: Reference, path: Path) -> None:
    """Write a binary PLY."""
    records = np.zeros(len(reference), _RECORD)
    for names, values in (
        (("x", "y", "z"), reference.points_m),
        (("nx", "ny", "nz"), reference.normals),
        (("red", "green", "blue"), reference.colors),
    ):
        for axis, name in enumerate(names):
            records[name] = values[:, axis]
    records["error"] = reference.error_m
    path.write_bytes(_header(len(records)) + records.tobytes())


def read_reference(path: Path) -> Reference:
    """A reference as `write_reference` writes it; `UserError` for any other file."""
    data = read_bytes(path, MAX_REFERENCE_BYTES)
    head, _, _ = data[:2000].partition(b"end_header\n")
    count = next(
        (
            int(line.split()[2])
            for line in head.splitlines()
            if line.startswith(b"element vertex ") and line.split()[2].isdigit()
        ),
        0,
    )
    header = _header(count)
    if not count or not data.startswith(header) or len(data) != len(header) + count * _RECORD.itemsize:
        raise UserError(f"{path} is damaged; import the photographs again with --force")
    records = np.frombuffer(data, _RECORD, offset=len(header))
    points, normals = (
        np.stack([records[n] for n in names], axis=1).astype(float)
        for names in (("x", "y", "z"), ("nx", "ny", "nz"))
    )
    error_m = records["error"].astype(float)
    if not (np.isfinite(points).all() and np.isfinite(normals).all() and np.isfinite(error_m).all()):
        raise UserError(
            f"{path} holds numbers that are not finite; import the photographs again with --force"
        )
    colors = np.stack([records[n] for n in ("red", "green", "blue")], axis=1)
    return Reference(points, normals, colors, error_m)


def _header(count: int) -> bytes:
    names = _RECORD.names or ()
    properties = "".join(f"property {_PLY_TYPES[_RECORD[name].str]} {name}\n" for name in names)
    return f"ply\nformat binary_little_endian 1.0\nelement vertex {count}\n{properties}end_header\n".encode()
