"""The rocks one can name: the procedural ones, the user's imported ones, and any mesh file."""

from __future__ import annotations

import difflib
import logging
import os
from functools import lru_cache
from pathlib import Path

from nbv.cache import home
from nbv.errors import UserError
from nbv.rocks import store
from nbv.rocks.procedural import generate_rock, generator_key
from nbv.rocks.recipes import RECIPES
from nbv.rocks.rock import Rock, RockInfo

log = logging.getLogger(__name__)

_IN_MEMORY = 16  # rocks of each kind, about 25 MB each


def list_rocks() -> list[RockInfo]:
    """Every rock `load_rock` knows by name: procedural ones first, then imported ones by name."""
    rocks = [RockInfo(r.name, r.split, "procedural", r.difficulty) for r in RECIPES.values()]
    folder = store.imported_dir()
    for path in sorted(folder.glob("*.npz")) if folder.is_dir() else []:
        try:
            split, difficulty = store.read_labels(path)
        except (store.DamagedRockError, FileNotFoundError) as error:
            log.warning("%s; import the rock again", error)
            continue
        rocks.append(RockInfo(path.stem, split, "imported", difficulty))
    return rocks


def load_rock(name: str) -> Rock:
    """The rock called ``name``: procedural, imported, or the path of a mesh file.

    A procedural rock is generated on first use (a few seconds) and kept in the cache folder; a mesh file
    is imported with the defaults of `import_mesh`, and nothing is kept on disk.

    Raises
    ------
    UserError
        There is no such rock (the message lists the known ones), or the mesh cannot be used.
    """
    path = Path(name).expanduser()
    if name in RECIPES:
        return _load_procedural(name, str(home()))
    stored = store.imported_path(name)
    if os.sep not in name and stored.is_file():
        return _load_imported(name, str(stored), stored.stat().st_mtime_ns)
    if path.is_file():
        return _load_file(str(path.resolve()), path.stat().st_mtime_ns)
    if os.sep in name or path.suffix:
        raise UserError(f"there is no mesh file {name!r}; check the path")
    known = [rock.name for rock in list_rocks()]
    close = difflib.get_close_matches(name, known, n=1)
    hint = f"did you mean {close[0]}? " if close else ""
    raise UserError(f"unknown rock {name!r}; {hint}known: {', '.join(known)}, or the path of a mesh file")


def save_imported(rock: Rock, *, force: bool = False) -> Path:
    """Keep an imported rock so that `load_rock` finds it by name.

    Raises
    ------
    UserError
        The name is not usable or taken (``force`` replaces an imported rock, never a procedural one).
    """
    store.check_name(rock.name)
    if rock.name in RECIPES:
        raise UserError(f"{rock.name!r} is the name of a procedural rock; choose another with --name")
    path = store.imported_path(rock.name)
    if path.exists() and not force:
        raise UserError(f"there is already a rock {rock.name!r}; choose another --name or pass --force")
    try:
        store.write_rock(rock, path)
    except OSError as error:
        raise UserError(f"cannot write {path}: {error}; set GATETUNE_HOME to a writable folder") from error
    return path


def remove_imported(name: str) -> None:
    """Forget an imported rock; ``UserError`` if there is none of that name."""
    path = store.imported_path(store.check_name(name))
    if not path.is_file():
        raise UserError(f"there is no imported rock {name!r} to remove")
    path.unlink()


@lru_cache(maxsize=_IN_MEMORY)
def _load_procedural(name: str, _home: str) -> Rock:
    path = store.generated_path(name, generator_key())
    try:
        rock = store.read_rock(path)
        if rock.name == name:
            return rock
        log.warning("%s holds another rock; generating %s again", path, name)
    except FileNotFoundError:
        pass
    except store.DamagedRockError as error:
        log.warning("%s; generating %s again", error, name)
    rock = generate_rock(name)
    try:
        store.write_rock(rock, path)
        for stale in path.parent.glob(f"{name}-*.npz"):  # of earlier generators
            if stale != path:
                stale.unlink(missing_ok=True)
    except OSError as error:  # the cache only saves time
        log.warning("cannot cache rock %s: %s", name, error)
    return rock


@lru_cache(maxsize=_IN_MEMORY)
def _load_imported(name: str, path: str, _mtime_ns: int) -> Rock:
    try:
        return store.read_rock(Path(path))
    except store.DamagedRockError as error:
        raise UserError(f"{error}; import the rock again with --force") from error


@lru_cache(maxsize=_IN_MEMORY)
def _load_file(path: str, _mtime_ns: int) -> Rock:
    from nbv.rocks.importer import import_mesh  # trimesh is only needed here

    return import_mesh(path)
