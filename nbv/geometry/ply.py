"""Point clouds as binary PLY, which viewers open."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from nbv.errors import UserError
from nbv.safe_files import read_bytes, write_atomic
from nbv.types import Cloud, Floats, PointCloud

MAX_BYTES = 2**31
_TYPES = {"float": "<f4", "uchar": "|u1"}


def write_ply(path: Path, cloud: Cloud, **more: Floats) -> None:
    """Positions, normals and ``more`` columns (N,) as float32, 8-bit colours; normals and colours where there are any."""
    columns = dict[str, Any]()
    for names, values in (
        ("x y z", cloud.points_m),
        ("nx ny nz", cloud.normals),
        ("red green blue", cloud.colors),
    ):
        if values is not None:
            columns |= dict(zip(names.split(), np.asarray(values, "u1" if "red" in names else "<f4").T))
    columns |= {name: np.asarray(values, "<f4") for name, values in more.items()}
    records = np.rec.fromarrays(list(columns.values()), names=list(columns))  # type: ignore[call-overload]
    told = [f"property {'uchar' if v.dtype == np.uint8 else 'float'} {name}" for name, v in columns.items()]
    head = ["ply", "format binary_little_endian 1.0", f"element vertex {len(records)}", *told, "end_header\n"]
    write_atomic(path, "\n".join(head).encode() + records.tobytes())


def read_ply(path: Path) -> tuple[PointCloud, dict[str, Floats]]:
    """What `write_ply` wrote: the cloud and the other columns; `UserError` for any other file."""
    head, _, body = read_bytes(path, MAX_BYTES).partition(b"end_header\n")
    try:
        _, form, element, *told = (line.split() for line in head.decode().splitlines())
        kinds = np.dtype([(name, _TYPES[kind]) for _, kind, name in told])
        records = np.frombuffer(body, kinds)
        if form[1] != "binary_little_endian" or len(records) != int(element[2]):
            raise ValueError("of another format, or cut off")
        columns = {name: records[name].astype(float) for name in kinds.names or ()}
        points, normals, colors = (
            np.column_stack([columns.pop(name) for name in names.split()])
            if names.split()[0] in columns
            else None
            for names in ("x y z", "nx ny nz", "red green blue")
        )
    except (ValueError, KeyError, IndexError) as error:
        raise UserError(f"{path} is damaged, or not of this program; make it again") from error
    if points is None or not all(np.isfinite(v).all() for v in (points, *columns.values())):
        raise UserError(f"{path} holds numbers that are not finite; make it again")
    return PointCloud(points, None if colors is None else colors.astype(np.uint8), normals), columns
