"""A content-addressed store of arrays, shared by many processes.

An entry is a dictionary of arrays under (kind, key); the key is a digest of everything that decides the
content. Entries are written to a temporary file and renamed, so a reader sees a whole entry or none, and
two processes that fill the same entry leave one of two equal files. Every entry carries a checksum: a
damaged one is noticed, removed and made anew by whoever needs it.

Caching wraps the stages (``nbv.photogrammetric.cached_stages``); no algorithm knows of this module.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import os
import shutil
import sys
import uuid
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from nbv.errors import UserError

_MAGIC = b"gatetune-entry-1"
DEFAULT_MAX_BYTES = 10 * 2**30
_PRUNE_EVERY_PUTS = 500

Arrays = dict[str, np.ndarray]


def home() -> Path:
    """Where rocks and caches live: ``$GATETUNE_HOME``, or the platform's cache folder."""
    if root := os.environ.get("GATETUNE_HOME"):
        return Path(root).expanduser()
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches" / "gatetune"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "gatetune"


def digest(*parts: Any) -> str:
    """32 hex digits that identify ``parts`` (JSON values, bytes or arrays)."""
    hasher = hashlib.sha256()
    for part in parts:
        if isinstance(part, np.ndarray):
            head = f"{part.dtype.str}{part.shape}".encode()
            body = np.ascontiguousarray(part).tobytes()
        elif isinstance(part, bytes):
            head, body = b"bytes", part
        else:
            head, body = b"json", json.dumps(part, sort_keys=True, separators=(",", ":")).encode()
        hasher.update(len(head).to_bytes(4, "little") + head + len(body).to_bytes(8, "little") + body)
    return hasher.hexdigest()[:32]


@dataclass(frozen=True)
class KindInfo:
    """Entries of one kind."""

    kind: str
    entries: int
    size_bytes: int


class Store:
    """Entries under ``root``; at most about ``max_bytes`` of them, least recently used go first."""

    def __init__(self, root: Path | None = None, max_bytes: int = DEFAULT_MAX_BYTES) -> None:
        self.root = root if root is not None else home() / "store"
        self.max_bytes = max_bytes
        self._puts = 0

    def get(self, kind: str, key: str) -> Arrays | None:
        """The entry, or ``None`` if it is absent or damaged (then it is removed)."""
        path = self._path(kind, key)
        try:
            data = path.read_bytes()
        except OSError:
            return None
        arrays = _unpack(data)
        if arrays is None:
            path.unlink(missing_ok=True)
            return None
        with contextlib.suppress(OSError):  # another process may have pruned it
            os.utime(path)  # recently used
        return arrays

    def put(self, kind: str, key: str, arrays: Arrays) -> None:
        """Write the entry. A full or read-only disk costs the entry, never the caller's result."""
        path = self._path(kind, key)
        temporary = path.with_name(f".{path.name}.{uuid.uuid4().hex}.tmp")
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            temporary.write_bytes(_pack(arrays))
            temporary.replace(path)
        except OSError:
            with contextlib.suppress(OSError):
                temporary.unlink(missing_ok=True)
            return
        self._puts += 1
        if self._puts % _PRUNE_EVERY_PUTS == 0:
            self.prune(self.max_bytes)

    def info(self) -> list[KindInfo]:
        """Number and size of the entries, by kind."""
        sizes: dict[str, list[int]] = {}
        for path in self._entries():
            try:
                sizes.setdefault(path.relative_to(self.root).parts[0], []).append(path.stat().st_size)
            except FileNotFoundError:  # another process pruned it
                continue
        return [KindInfo(kind, len(items), sum(items)) for kind, items in sorted(sizes.items())]

    def prune(self, max_bytes: int) -> tuple[int, int]:
        """Remove least recently used entries until at most ``max_bytes`` are left: (entries, bytes) removed."""
        if max_bytes < 0:
            raise UserError(f"cache size must be 0 or more, not {max_bytes}")
        listed = []
        for path in self._entries():
            try:
                status = path.stat()
            except FileNotFoundError:
                continue
            listed.append((status.st_mtime, status.st_size, path))
        total = sum(size for _, size, _ in listed)
        removed = freed = 0
        for _, size, path in sorted(listed, key=lambda item: item[0]):
            if total - freed <= max_bytes:
                break
            path.unlink(missing_ok=True)
            removed, freed = removed + 1, freed + size
        return removed, freed

    def verify(self) -> tuple[int, int]:
        """Check every entry's checksum and remove the damaged: (entries checked, entries removed)."""
        checked = damaged = 0
        for path in self._entries():
            try:
                data = path.read_bytes()
            except FileNotFoundError:
                continue
            checked += 1
            if _unpack(data) is None:
                path.unlink(missing_ok=True)
                damaged += 1
        return checked, damaged

    def clear(self) -> None:
        """Remove everything."""
        shutil.rmtree(self.root, ignore_errors=True)

    def _path(self, kind: str, key: str) -> Path:
        return self.root / kind / key[:2] / key

    def _entries(self) -> Iterator[Path]:
        if self.root.is_dir():
            yield from (path for path in self.root.glob("*/??/*") if not path.name.startswith("."))


def _pack(arrays: Arrays) -> bytes:
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)  # type: ignore[arg-type]
    payload = buffer.getvalue()
    return _MAGIC + hashlib.sha256(payload).digest() + payload


def _unpack(data: bytes) -> Arrays | None:
    start = len(_MAGIC) + 32
    if data[: len(_MAGIC)] != _MAGIC or hashlib.sha256(data[start:]).digest() != data[len(_MAGIC) : start]:
        return None
    with np.load(io.BytesIO(data[start:]), allow_pickle=False) as entry:
        return {name: entry[name] for name in entry.files}
