"""One cache with one rule. What a stage made is kept under a key, a digest of everything that decides it:

* the *kind* of thing;
* its *inputs*: pixels, poses, options, a rock's SHA-256;
* the source code that makes it, with all that this code imports, and the libraries' versions (`code_digest`).

An entry is stale when its key is no longer asked for, and never otherwise: there is no number to raise by hand.
`cached` is the rule in one call; without a store it only calls ``make``, so nothing is read or written. Stores are
handed from the mission down to the stages; no algorithm opens one.

Rocks that a user imported by name live beside the store (``nbv.rocks.catalogue``) and are not part of it.

A store is shared by many processes. An entry is a dictionary of arrays under (kind, key). Entries are written to a temporary file and
renamed, so a reader sees a whole entry or none, and two processes that fill the same entry leave one of two equal files. An entry
that is damaged is noticed by the archive's own checksums, removed and made anew by whoever needs it.
"""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import hashlib
import io
import json
import os
import re
import sys
import time
from collections import OrderedDict
from collections.abc import Callable, Hashable, Sequence
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np

from nbv.errors import MissionFailure, UserError
from nbv.provenance import MISSION_LIBRARIES, versions
from nbv.safe_files import expanded, read_bytes, write_atomic

# The key of a stored thing: a digest of its inputs, of the code that makes it and of the libraries below; `cached`.


_PACKAGE = Path(__file__).resolve().parent  # nbv/
_IMPORT = re.compile(
    r"^[ \t]*(?:from|import)[ \t]+(nbv[\w.]*)(?:[ \t]+import[ \t]+(\([^)]*\)|[^\n]*))?", re.MULTILINE
)


def digest(*parts: Any) -> str:
    """32 hex digits that identify ``parts`` (JSON values, dataclasses of them, bytes or arrays)."""
    hasher = hashlib.sha256()
    for part in parts:
        if isinstance(part, np.ndarray):
            head = f"{part.dtype.str}{part.shape}".encode()
            body = np.ascontiguousarray(part).tobytes()
        elif isinstance(part, bytes):
            head, body = b"bytes", part
        else:
            tree = dataclasses.asdict(part) if dataclasses.is_dataclass(part) else part  # type: ignore[arg-type]
            head, body = b"json", json.dumps(tree, sort_keys=True, separators=(",", ":")).encode()
        hasher.update(len(head).to_bytes(4, "little") + head + len(body).to_bytes(8, "little") + body)
    return hasher.hexdigest()[:32]


def cache_key(code: str, *inputs: Any) -> str:
    """The key of what the module or package ``code`` makes of ``inputs`` (each as `digest` takes it)."""
    return digest(code, code_digest(code), *inputs)


def cached(
    store: Store | None,
    kind: str,
    make: Callable[[], Arrays],
    *,
    code: str,
    inputs: Sequence[Any],
) -> Arrays:
    """What ``make`` gives, from the store if it is there.

    ``store`` None: nothing is read or written. ``kind`` is the folder of the store. What ``make`` raises is raised, and
    nothing is kept. ``code`` is the module or package that makes it (`code_digest`), ``inputs`` everything else that decides it, each
    as `nbv.cache.digest` takes it.
    """
    if store is None:
        return make()
    key = cache_key(code, *inputs)
    entry = store.get(kind, key)
    if entry is None:
        entry = make()
        store.put(kind, key, entry)
    return entry


def cached_json(store: Store | None, kind: str, make: Callable[[], Any], **more: Any) -> Any:
    """`cached` for a JSON value, with the same ``code`` and ``inputs``."""

    def json_as_array() -> Arrays:
        return {"json": np.frombuffer(json.dumps(make()).encode(), np.uint8)}

    return json.loads(cached(store, kind, json_as_array, **more)["json"].tobytes())


@functools.cache
def code_digest(module: str) -> str:
    """Digest of the source of ``module`` and of all of ``nbv`` that it imports, and of the libraries' versions.

    Imports are followed through the text of the files, so that no list of them can be forgotten. A package stands for
    all of its files. `ValueError` where there is no such module.
    """
    installed = {name: version for name, version in versions().items() if name in MISSION_LIBRARIES}
    waiting, imported = set(_modules_of(module)), set[str]()
    if not waiting:
        raise ValueError(f"there is no module {module}")
    while waiting:
        name = waiting.pop()
        imported.add(name)
        waiting |= _imports_of(name) - imported
    return digest(installed, *(f"{name}\n{_sources()[name]}" for name in sorted(imported)))


@functools.cache
def _imports_of(name: str) -> frozenset[str]:
    # What is imported is a module of the package, or a name that the module or package defines.
    return frozenset[str]().union(
        *(
            _modules_of(f"{source}.{imported}") or _modules_of(source)
            for source, names in _IMPORT.findall(_sources()[name])
            for imported in re.findall(r"\w+", names) or [""]
        )
    )


@functools.cache
def _modules_of(name: str) -> frozenset[str]:
    """The module ``name``, or the modules of the package ``name``; of ``nbv`` itself none."""
    in_package = name != _PACKAGE.name
    return frozenset(m for m in _sources() if m == name or (in_package and m.rpartition(".")[0] == name))


@functools.cache
def _sources() -> dict[str, str]:
    """The text of every module of the package, by dotted name."""
    files = ((path.relative_to(_PACKAGE.parent).with_suffix(""), path) for path in _PACKAGE.rglob("*.py"))
    return {".".join(relative.parts): path.read_text() for relative, path in files}


# A least-recently-used cache in memory.


Item = TypeVar("Item")


class Recent(Generic[Item]):
    """At most ``size`` values by key; the least recently used one is dropped first."""

    def __init__(self, size: int) -> None:
        self._size = size
        self._values: OrderedDict[Hashable, Item] = OrderedDict()

    def get(self, key: Hashable, make: Callable[[], Item]) -> Item:
        if key not in self._values:
            self._values[key] = make()
            if len(self._values) > self._size:
                self._values.popitem(last=False)
        self._values.move_to_end(key)
        return self._values[key]

    def clear(self) -> None:
        self._values.clear()


_NAME = re.compile(r"[a-z0-9][a-z0-9_-]*")
DEFAULT_MAX_BYTES = 10 * 2**30
_LEFT_S = 86_400.0  # nobody writes an entry for so long
_PARTS = 20  # the store is pruned about so often while as much as its size limit is written
Arrays = dict[str, np.ndarray]


def home() -> Path:
    """Where rocks and caches live: ``$GATETUNE_HOME``, or the platform's cache folder."""
    if root := os.environ.get("GATETUNE_HOME"):
        return expanded(root)
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches" / "gatetune"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "gatetune"


class Store:
    """Entries under ``root``, by default the user's; at most about ``max_bytes`` of them, least recently used go first."""

    def __init__(self, root: Path | None = None, max_bytes: int = DEFAULT_MAX_BYTES) -> None:
        self.root = root if root is not None else home() / "store"
        self.max_bytes = max_bytes

    def get(self, kind: str, key: str) -> Arrays | None:
        """The entry, or ``None`` if it is absent or damaged (then it is removed)."""
        path = self._path(kind, key)
        try:
            data = read_bytes(path, DEFAULT_MAX_BYTES)
        except UserError:  # absent
            return None
        arrays = _unpack(data)
        with contextlib.suppress(OSError):  # another process has pruned it, or nobody may write there
            if arrays is None:
                path.unlink()
            else:
                os.utime(path)  # recently used
        return arrays

    def put(self, kind: str, key: str, arrays: Arrays) -> None:
        """Write the entry. A full or read-only disk costs the entry, never the caller's result."""
        buffer, path = io.BytesIO(), self._path(kind, key)
        np.savez(buffer, **arrays)  # type: ignore[arg-type]
        with contextlib.suppress(OSError):
            path.parent.mkdir(parents=True, exist_ok=True)
            write_atomic(path, buffer.getbuffer())
        # By chance, as large as the entry: many processes put a few each, and none knows of the others'.
        if _PARTS * buffer.tell() > self.max_bytes * int.from_bytes(os.urandom(4), "big") / 2**32:
            with contextlib.suppress(OSError):  # nobody may write there
                self.prune(self.max_bytes * (_PARTS - 1) // _PARTS)

    def prune(self, max_bytes: int) -> tuple[int, int]:
        """Remove least recently used entries until at most ``max_bytes`` are left: (entries, bytes) removed.

        Besides, what processes that were killed left half written. `OSError` where nobody may remove an entry.
        """
        if max_bytes < 0:
            raise UserError(f"cache size must be 0 or more, not {max_bytes}")
        for path in self.root.glob("*/??/.*.tmp"):
            with contextlib.suppress(FileNotFoundError):
                if path.stat().st_mtime < time.time() - _LEFT_S:
                    path.unlink()
        listed = []
        for path in self.root.glob("*/??/[!.]*"):
            with contextlib.suppress(FileNotFoundError):
                status = path.stat()
                listed.append((status.st_mtime, status.st_size, path))
        total = sum(size for _, size, _ in listed)
        removed = freed = 0
        for _, size, path in sorted(listed, key=lambda item: item[0]):
            if total - freed <= max_bytes:
                break
            path.unlink(missing_ok=True)
            removed, freed = removed + 1, freed + size
        return removed, freed

    def _path(self, kind: str, key: str) -> Path:
        for name in (kind, key):
            if not _NAME.fullmatch(name):
                raise ValueError(f"{name!r} cannot name an entry of the store")
        return self.root / kind / key[:2] / key


class KnownOnly(Store):
    """The user's store for a mission that may compute nothing: what is not there ends it with ``not_known``."""

    def get(self, kind: str, key: str) -> Arrays:
        """The entry; `MissionFailure` if it is absent."""
        entry = super().get(kind, key)
        if entry is None:
            raise MissionFailure("not_known", f"no entry of {kind} in the store")
        return entry

    def put(self, kind: str, key: str, arrays: Arrays) -> None:
        """Nothing."""


def _unpack(data: bytes) -> Arrays | None:
    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as entry:
            arrays = {name: entry[name] for name in entry.files}
        # Python reads as many members as the directory's size allows, without a look at how many the archive says that it has; and
        # it looks for the archive's end in what follows as well, which is nothing here.
        is_whole = data[-22:-18] == b"PK\x05\x06" and len(arrays) == int.from_bytes(data[-12:-10], "little")
        return arrays if is_whole else None
    except Exception:  # zipfile, zlib and NumPy each raise families of their own
        return None
