"""The rocks one can name: the procedural ones, the user's imported ones, and any mesh file."""

from __future__ import annotations

import difflib
import functools
import os
from collections.abc import Callable, Hashable
from pathlib import Path

from nbv.cache import Store
from nbv.errors import UserError
from nbv.rocks.families import FAMILIES, generated_name
from nbv.rocks.imported import imported_path, list_kept, read_rock, surface_path
from nbv.rocks.importer import import_mesh
from nbv.rocks.procedural import COARSE_GRID_M, generate_rock
from nbv.rocks.recipes import RECIPES
from nbv.rocks.rock import Rock, RockInfo
from nbv.safe_files import expanded, is_file

KEPT = ".npz"  # of a rock as this program keeps it
_MAX_LOADED = 16  # about 25 MB each
_loaded: dict[Hashable, Rock] = {}  # least recently asked for first


def list_rocks() -> list[RockInfo]:
    """Every rock `load_rock` knows by name: procedural ones first, then imported ones by name."""
    return [
        *(RockInfo(r.name, r.split, "procedural", r.difficulty) for r in RECIPES.values()),
        *list_kept(),
    ]


def load_rock(name: str, store: Store | None = None) -> Rock:
    """The rock called ``name``: procedural (``FAMILY-SEED`` too), imported, or the path of a mesh file (or of a rock as `write_rock` writes it).

    A procedural rock takes a few seconds to make; ``store`` keeps it for the next process. A mesh file is imported
    with the defaults of `import_mesh`, and nothing is kept on disk. Rocks stay in this process's memory.

    Raises
    ------
    UserError
        There is no such rock (the message lists the known ones), or the mesh cannot be used.
    """
    if name in RECIPES or generated_name(name) is not None:
        return _once(name, lambda: generate_rock(name, store))
    path = expanded(name)
    named = () if os.sep in name else (imported_path(name), surface_path(name))
    for file in (*named, path):
        if is_file(file):
            load = _read_kept if file.suffix == KEPT else import_mesh
            return _once((str(file.resolve()), file.stat().st_mtime_ns), functools.partial(load, file))
    if os.sep in name or path.suffix:
        raise UserError(f"there is no mesh file {name!r}; check the path")
    known = [rock.name for rock in list_rocks()]
    close = difflib.get_close_matches(name, known, n=1)
    hint = f"did you mean {close[0]}? " if close else ""
    raise UserError(
        f"unknown rock {name!r}; {hint}known: {', '.join(known)}, {next(iter(FAMILIES))}-SEED, or the path of a mesh file"
    )


def load_coarse_rock(name: str, store: Store | None = None) -> Rock:
    """`load_rock`, but a drawn rock (``FAMILY-SEED``) as a coarse mesh, in a tenth of the time: nobody photographs it.

    It has a hash of its own, by which errors and noise are drawn.
    """
    if generated_name(name) is None:
        return load_rock(name, store)
    return _once((name, COARSE_GRID_M), lambda: generate_rock(name, store, grid_m=COARSE_GRID_M))


def forget_loaded() -> None:
    """Remove all rocks from this process's memory."""
    _loaded.clear()


def _once(key: Hashable, load: Callable[[], Rock]) -> Rock:
    rock = _loaded.pop(key, None)
    if rock is None:
        rock = load()
        while len(_loaded) >= _MAX_LOADED:
            _loaded.pop(next(iter(_loaded)))
    _loaded[key] = rock
    return rock


def _read_kept(path: Path) -> Rock:
    try:
        return read_rock(path)
    except UserError as error:
        raise UserError(f"{error}; import the rock again with --force") from error
