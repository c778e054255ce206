"""The key of a stored thing: a digest of its inputs, of the code that makes it and of the libraries below; `cached`."""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import json
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from nbv.cache.store import Arrays, Store
from nbv.provenance import MISSION_LIBRARIES, versions

_PACKAGE = Path(__file__).resolve().parents[1]  # nbv/
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

    ``store`` None: nothing is read or written. ``kind`` is what ``gatetune cache info`` calls it. What ``make`` raises is raised, and
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
    all of its files.
    """
    installed = {name: version for name, version in versions().items() if name in MISSION_LIBRARIES}
    return digest(installed, *(f"{name}\n{_sources()[name]}" for name in sorted(imported_modules(module))))


def imported_modules(module: str) -> set[str]:
    """The modules below ``nbv`` that are ``module``, or in it, or imported by these; by dotted name.

    `ValueError` where there is no such module.
    """
    waiting, imported = set(_modules_of(module)), set[str]()
    if not waiting:
        raise ValueError(f"there is no module {module}")
    while waiting:
        name = waiting.pop()
        imported.add(name)
        waiting |= _imports_of(name) - imported
    return imported


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
