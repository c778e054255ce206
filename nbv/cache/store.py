"""A store of arrays, shared by many processes.

An entry is a dictionary of arrays under (kind, key). Entries are written to a temporary file and renamed, so a
reader sees a whole entry or none, and two processes that fill the same entry leave one of two equal files. Every
entry carries a checksum of its kind, its key and its content: one that is damaged or lies under another's name is
noticed, removed and made anew by whoever needs it.

Machines may share a folder besides, ``$GATETUNE_SHARED_STORE``: what a store does not have is looked for there and kept, and
what it is given is put there too. Nothing removes what is old from it.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import os
import re
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from nbv.errors import MissionFailure, UserError
from nbv.safe_files import expanded, read_bytes, write_atomic

_MAGIC = b"gatetune-entry-2"
_HEAD_BYTES = len(_MAGIC) + hashlib.sha256().digest_size
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
    """Entries under ``root``; at most about ``max_bytes`` of them, least recently used go first.

    Without a root it is the user's, and what ``$GATETUNE_SHARED_STORE`` holds is taken from there.
    """

    def __init__(self, root: Path | None = None, max_bytes: int = DEFAULT_MAX_BYTES) -> None:
        self.root = root if root is not None else home() / "store"
        self.max_bytes = max_bytes
        shared = os.environ.get("GATETUNE_SHARED_STORE") if root is None else None
        self._shared = Store(expanded(shared)) if shared else None

    def get(self, kind: str, key: str) -> Arrays | None:
        """The entry, or ``None`` if it is absent or not what was put there (then it is removed)."""
        entry = self._read(kind, key)
        if entry is None and self._shared is not None:
            entry = self._shared._read(kind, key)
            if entry is not None:
                self._keep(kind, key, entry[0])
        return None if entry is None else entry[1]

    def put(self, kind: str, key: str, arrays: Arrays) -> None:
        """Write the entry. A full or read-only disk costs the entry, never the caller's result."""
        buffer = io.BytesIO()
        np.savez(buffer, **arrays)  # type: ignore[arg-type]
        payload = buffer.getbuffer()
        data = b"".join((_MAGIC, _checksum(kind, key, payload), payload))
        self._keep(kind, key, data)
        if self._shared is not None:
            self._shared._write(kind, key, data)

    def _keep(self, kind: str, key: str, data: bytes) -> None:
        self._write(kind, key, data)
        # By chance, as large as the entry: many processes put a few each, and none knows of the others'.
        if _PARTS * len(data) > self.max_bytes * int.from_bytes(os.urandom(4), "big") / 2**32:
            with contextlib.suppress(OSError):  # nobody may write there
                self.prune(self.max_bytes * (_PARTS - 1) // _PARTS)

    def _read(self, kind: str, key: str) -> tuple[bytes, Arrays] | None:
        path = self._path(kind, key)
        try:
            data = read_bytes(path, DEFAULT_MAX_BYTES)
        except UserError:  # absent, or no file: others may write to a shared folder
            return None
        sound = data[:_HEAD_BYTES] == _MAGIC + _checksum(kind, key, memoryview(data)[_HEAD_BYTES:])
        arrays = _unpack(data) if sound else None
        if arrays is None:
            with contextlib.suppress(OSError):  # another process has pruned it, or nobody may write there
                path.unlink()
            return None
        with contextlib.suppress(OSError):
            os.utime(path)  # recently used
        return data, arrays

    def _write(self, kind: str, key: str, data: bytes) -> None:
        path = self._path(kind, key)
        with contextlib.suppress(OSError):
            path.parent.mkdir(parents=True, exist_ok=True)
            write_atomic(path, data)

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
        for path in self._entries():
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

    def _entries(self) -> Iterator[Path]:
        if self.root.is_dir():
            yield from (path for path in self.root.glob("*/??/*") if not path.name.startswith("."))


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
        with np.load(io.BytesIO(memoryview(data)[_HEAD_BYTES:]), allow_pickle=False) as entry:
            return {name: entry[name] for name in entry.files}
    except Exception:  # zipfile, zlib and NumPy each raise families of their own
        return None


def _checksum(kind: str, key: str, payload: memoryview) -> bytes:
    hasher = hashlib.sha256(f"{kind}/{key}\n".encode())
    hasher.update(payload)
    return hasher.digest()
