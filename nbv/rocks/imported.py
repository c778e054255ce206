"""The user's own rocks: kept by name, one file each, with a checksum.

They are the user's data and no cache: nothing here is made anew or removed unless the user says so.
"""

from __future__ import annotations

import io
import logging
import re
from collections.abc import Sequence
from pathlib import Path
from typing import cast

import numpy as np

from nbv.cache import home
from nbv.errors import UserError
from nbv.rocks.recipes import RECIPES
from nbv.rocks.rock import SPLITS, Rock, RockInfo, Source, Split, make_rock
from nbv.safe_files import read_npz, write_atomic

log = logging.getLogger(__name__)

_FORMAT = 1
_LABELS = {"split": "U", "difficulty": "U"}
_CONTENT = {
    "format": "iu",
    "name": "U",
    "vertices_m": "f n 3",
    "faces": "iu _ 3 <n",
    "albedo": "fu n 3",
    "notes": "U _",
    "sha256": "U",
}
_NAME = re.compile(r"[a-z0-9][a-z0-9_-]{0,63}")


def imported_path(name: str) -> Path:
    """Where the imported rock ``name`` is kept."""
    return home() / "rocks" / "imported" / f"{name}.npz"


def surface_path(name: str) -> Path:
    """Where the surface of the set of photographs ``name`` is kept, if there is such a set (`nbv.photographs`)."""
    return home() / "photographs" / name / "surface.npz"


def is_photographed(name: str) -> bool:
    """Whether ``name`` is a set of photographs, and no other rock."""
    return (
        _NAME.fullmatch(name) is not None
        and surface_path(name).is_file()
        and not imported_path(name).is_file()
    )


def are_photographed(rocks: Sequence[str]) -> bool:
    """Whether there are rocks, and every one is a set of photographs."""
    return bool(rocks) and all(map(is_photographed, rocks))


def list_kept() -> list[RockInfo]:
    """Imported rocks, then surfaces of sets of photographs, by name; a warning for a file that cannot be read."""
    meshes = sorted(imported_path("NAME").parent.glob("*.npz"))
    sets = sorted(
        p for p in surface_path("NAME").parents[1].glob("*/surface.npz") if is_photographed(p.parent.name)
    )
    rocks = []
    for path in (*meshes, *sets):
        name = path.stem if path in meshes else path.parent.name
        try:
            data = read_npz(path, _LABELS)
            source: Source = "imported" if path in meshes else "photographs"
            rocks.append(RockInfo(name, _split(path, data), source, str(data["difficulty"])))
        except UserError as error:
            log.warning("%s; import it again", error)
    return rocks


def save_imported(rock: Rock, *, force: bool = False) -> Path:
    """Keep an imported rock so that `nbv.rocks.load_rock` finds it by name.

    Raises
    ------
    UserError
        The name is not usable or taken (``force`` replaces an imported rock, never a procedural one).
    """
    check_name(rock.name)
    if rock.name in RECIPES:
        raise UserError(f"{rock.name!r} is the name of a procedural rock; choose another with --name")
    path = imported_path(rock.name)
    if path.exists() and not force:
        raise UserError(f"there is already a rock {rock.name!r}; choose another --name or pass --force")
    try:
        write_rock(rock, path)
    except OSError as error:
        raise UserError(f"cannot write {path}: {error}; set GATETUNE_HOME to a writable folder") from error
    return path


def check_name(name: str) -> str:
    """``name`` if it can name a rock, else ``UserError``."""
    if not _NAME.fullmatch(name):
        raise UserError(
            f"{name!r} cannot name a rock; use up to 64 lower-case letters, digits, '-' and '_', "
            "beginning with a letter or digit"
        )
    return name


def write_rock(rock: Rock, path: Path) -> None:
    """Write ``rock`` so that a reader sees the whole file or none of it."""
    buffer = io.BytesIO()
    np.savez(
        buffer,
        format=np.array(_FORMAT),
        name=np.array(rock.name),
        vertices_m=rock.vertices_m,
        faces=rock.faces.astype(np.int32),
        albedo=rock.albedo,
        split=np.array(rock.split),
        difficulty=np.array(rock.difficulty),
        notes=np.array(rock.notes, dtype=np.str_),
        sha256=np.array(rock.sha256),
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomic(path, buffer.getbuffer())


def read_rock(path: Path) -> Rock:
    """Read a rock back; `UserError` where there is none, or one that is not as it was written."""
    data = read_npz(path, {**_LABELS, **_CONTENT})
    if int(data["format"]) != _FORMAT:
        raise UserError(f"{path} has format {int(data['format'])}, not {_FORMAT}")
    rock = make_rock(
        str(data["name"]),
        data["vertices_m"],
        data["faces"],
        data["albedo"],
        split=_split(path, data),
        difficulty=str(data["difficulty"]),
        notes=tuple(str(note) for note in data["notes"]),
    )
    if rock.sha256 != str(data["sha256"]):
        raise UserError(f"{path} does not have the content it was written with")
    return rock


def _split(path: Path, data: dict[str, np.ndarray]) -> Split:
    split = str(data["split"])
    if split not in SPLITS:
        raise UserError(f"{path} has the unknown split {split[:40]!r}")
    return cast(Split, split)
