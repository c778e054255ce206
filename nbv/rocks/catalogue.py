"""The rocks one can name: the procedural ones, the user's imported ones, and any mesh file.

Imported rocks are kept by name, one file each. They are the user's data and no cache: nothing here is
made anew or removed unless the user says so.
"""

from __future__ import annotations

import difflib
import io
import logging
import os
import re
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import cast

import numpy as np

from nbv.cache import Recent, Store, home
from nbv.errors import UserError
from nbv.rocks.families import FAMILIES, generated_name
from nbv.rocks.importer import stored_import
from nbv.rocks.procedural import COARSE_GRID_M, generate_rock
from nbv.rocks.recipes import RECIPES
from nbv.rocks.rock import SPLITS, Rock, RockInfo, RockSource, Split, make_rock, rock_arrays
from nbv.safe_files import NPZ_BYTES, expanded, is_file, read_npz, require, write_atomic

log = logging.getLogger(__name__)

KEPT = ".npz"  # of a rock as this program keeps it
_FORMAT = 1
_LABELS = ("split", "difficulty")
_CONTENT = ("format", "name", "vertices_m", "faces", "albedo", "notes", "sha256")
_NAME = re.compile(r"[a-z0-9][a-z0-9_-]{0,63}")
LOADED: Recent[Rock] = Recent(16)  # in this process's memory; about 25 MB each


def list_rocks() -> list[RockInfo]:
    """Every rock `load_rock` knows by name: procedural ones, imported ones, surfaces of sets of photographs; each by name.

    A file that cannot be read is left out, with a warning.
    """
    rocks = [RockInfo(name, r.split, "procedural", r.difficulty) for name, r in RECIPES.items()]
    imported = sorted(imported_path("NAME").parent.glob("*.npz"))
    sets = sorted(surface_path("NAME").parents[1].glob("*/surface.npz"))
    files: list[tuple[str, Path, RockSource]] = [(path.stem, path, "imported") for path in imported]
    files += [(p.parent.name, p, "photographs") for p in sets if is_photographed(p.parent.name)]
    for name, path, source in files:
        try:
            data = read_npz(path, _LABELS)
            rocks.append(RockInfo(name, _split(path, data), source, str(data["difficulty"])))
        except UserError as error:
            log.warning("%s; import it again", error)
    return rocks


def load_rock(name: str, store: Store | None = None) -> Rock:
    """The rock called ``name``: procedural (``FAMILY-SEED`` too), imported, or the path of a mesh file (or of a rock as `write_rock` writes it).

    A procedural rock takes a few seconds to make, and an own mesh up to a minute to import, with the defaults of `import_mesh`;
    ``store`` keeps both for the next process. `UserError` where there is no such rock, or the mesh cannot be used.
    """
    if name in RECIPES or generated_name(name) is not None:
        return LOADED.get(name, lambda: generate_rock(name, store))
    path = expanded(name)
    named = () if os.sep in name else (imported_path(name), surface_path(name))
    for file in (*named, path):
        if is_file(file):
            make = partial(read_rock, file) if file.suffix == KEPT else partial(stored_import, file, store)
            return LOADED.get((str(file.resolve()), file.stat().st_mtime_ns), make)
    if os.sep in name or path.suffix:
        raise UserError(f"there is no mesh file {name!r}; check the path")
    known = [rock.name for rock in list_rocks()]
    close = difflib.get_close_matches(name, known, n=1)
    hint = f"did you mean {close[0]}? " if close else ""
    raise UserError(
        f"unknown rock {name!r}; {hint}known: {', '.join(known)}, {next(iter(FAMILIES))}-SEED, or the path of a mesh file"
    )


def load_coarse_rock(name: str, store: Store | None = None) -> Rock:
    """`load_rock`, but a generated rock (``FAMILY-SEED``) as a coarse mesh, in a tenth of the time, for missions that render nothing.

    The coarse mesh has a hash of its own, which seeds the errors and the noise of missions.
    """
    if generated_name(name) is None:
        return load_rock(name, store)
    return LOADED.get((name, COARSE_GRID_M), lambda: generate_rock(name, store, grid_m=COARSE_GRID_M))


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


def save_imported(rock: Rock, *, force: bool = False) -> Path:
    """Keep an imported rock so that `nbv.rocks.load_rock` finds it by name.

    `UserError` where the name is not usable or taken (``force`` replaces an imported rock, never a procedural one).
    """
    check_name(rock.name)
    if surface_path(rock.name).exists():
        raise UserError(f"{rock.name!r} is the name of a set of photographs; choose another --name")
    path = imported_path(rock.name)
    if path.exists() and not force:
        raise UserError(f"there is already a rock {rock.name!r}; choose another --name or pass --force")
    try:
        write_rock(rock, path)
    except OSError as error:
        raise UserError(f"cannot write {path}: {error}; set GATETUNE_HOME to a writable folder") from error
    return path


def check_name(name: str, what: str = "a rock") -> str:
    """``name`` if it can name a rock or a set of photographs and means nothing else, else ``UserError``."""
    if not _NAME.fullmatch(name):
        raise UserError(
            f"{name!r} cannot name {what}; use up to 64 lower-case letters, digits, '-' and '_', "
            "beginning with a letter or digit"
        )
    if name in RECIPES or generated_name(name) is not None:
        raise UserError(
            f"{name!r} already means a procedural rock, as does FAMILY-SEED; choose another --name"
        )
    return name


def write_rock(rock: Rock, path: Path) -> None:
    """Write ``rock`` so that a reader sees the whole file or none of it; `UserError` where it is too large to be read back."""
    buffer = io.BytesIO()
    np.savez(buffer, format=np.array(_FORMAT), **rock_arrays(rock))  # type: ignore[arg-type]
    require(buffer.tell(), NPZ_BYTES, f"the size of rock {rock.name} in bytes")
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomic(path, buffer.getbuffer())


def read_rock(path: Path) -> Rock:
    """Read a rock back; `UserError` where there is none, or one that is not as it was written."""
    try:
        data = read_npz(path, (*_LABELS, *_CONTENT))
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
    except UserError as error:
        raise UserError(f"{error}; import the rock again with --force") from error


def _split(path: Path, data: Mapping[str, np.ndarray]) -> Split:
    split = str(data["split"])
    if split not in SPLITS:
        raise UserError(f"{path} has the unknown split {split[:40]!r}")
    return cast(Split, split)
