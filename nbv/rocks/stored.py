"""Rocks in the store, by what they are made from: name and hash are there at once, the mesh is read when it is used."""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from nbv.cache import Arrays, Store, cache_key, cached, cached_json, digest
from nbv.errors import UserError
from nbv.rocks.importer import import_mesh
from nbv.rocks.mesh_file import MAX_FILE_BYTES, read_side_file
from nbv.rocks.rock import Rock
from nbv.safe_files import read_bytes

_MESH = ("vertices_m", "faces", "albedo")
_FACTS = ("name", "split", "difficulty", "sha256", "notes")


class UnreadRock(Rock):
    """A rock whose mesh has not been read; a geometric mission in a known world asks for the hash alone."""

    _read: Callable[[], Rock]

    def __getattr__(self, name: str) -> Any:
        """The mesh's arrays, which no attribute holds."""
        if name not in _MESH:
            raise AttributeError(name)
        return getattr(self._read(), name)


def stored_rock(store: Store | None, make: Callable[[], Rock], *, code: str, inputs: Sequence[Any]) -> Rock:
    """The rock that ``make`` makes, from ``store`` where it is there; ``code`` and ``inputs`` as `nbv.cache.cached` has them."""
    if store is None:
        return make()
    made: list[Rock] = []

    def arrays() -> Arrays:
        made.append(make())
        return {name: getattr(made[0], name) for name in _MESH} | {"faces": made[0].faces.astype(np.int32)}

    @functools.cache
    def read() -> Rock:
        mesh: dict[str, Any] = dict(cached(store, "rocks", arrays, code=code, inputs=inputs))
        if made:
            return made[0]
        mesh["faces"] = mesh["faces"].astype(np.int64)
        for array in mesh.values():
            array.setflags(write=False)
        both: dict[str, Any] = {**mesh, **facts}
        return Rock(**both)

    facts = cached_json(
        store,
        "rocks",
        lambda: {name: getattr(read(), name) for name in _FACTS},
        code=code,
        inputs=[*inputs, "facts"],
    )
    if made:
        return made[0]
    facts["notes"] = tuple(facts["notes"])
    rock = object.__new__(UnreadRock)
    for name, value in {**facts, "_read": read}.items():
        object.__setattr__(rock, name, value)
    return rock


def stored_import(path: Path, store: Store | None) -> Rock:
    """`import_mesh` with its defaults, from ``store`` where the mesh file and those that it names are as they were then."""
    if store is None or path.stat().st_size > MAX_FILE_BYTES:
        return import_mesh(path)
    content = digest(read_bytes(path, MAX_FILE_BYTES))
    key = cache_key(__name__, path.name, content)
    entry = store.get("rocks", key)
    beside = {} if entry is None else dict(zip(*(entry[part].tolist() for part in ("names", "digests"))))
    made: list[Rock] = []
    if entry is None or beside != _digests(path.parent, beside):
        side_files: list[str] = []
        made.append(import_mesh(path, side_files=side_files))
        beside = _digests(path.parent, side_files)
        parts = {"names": list(beside), "digests": list(beside.values())}
        store.put("rocks", key, {name: np.array(part, dtype=np.str_) for name, part in parts.items()})
    inputs = [path.name, content, beside]
    return stored_rock(store, lambda: made.pop() if made else import_mesh(path), code=__name__, inputs=inputs)


def _digests(folder: Path, names: Iterable[str]) -> dict[str, str]:
    """What the files beside a mesh hold; "" where one cannot be read."""
    digests = dict.fromkeys(names, "")
    for name in digests:
        with contextlib.suppress(UserError):
            digests[name] = digest(read_side_file(folder.resolve(), name))
    return digests
