"""Baked light on disk: a result is a function of its key, so a damaged entry is simply baked again."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import tempfile
import zipfile
from collections.abc import Callable, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

Arrays = Mapping[str, np.ndarray]

_BAKING_MODULES = ("ground.py", "bake.py", "bake_cache.py")


def cache_home() -> Path:
    """``$GATETUNE_HOME``, or ``~/.cache/gatetune``."""
    return Path(os.environ.get("GATETUNE_HOME") or Path.home() / ".cache" / "gatetune").expanduser()


@lru_cache(maxsize=1)
def baking_code_digest() -> str:
    """SHA-256 of the source that decides baked values: editing it makes old entries unreachable."""
    digest = hashlib.sha256()
    for name in _BAKING_MODULES:
        digest.update((Path(__file__).parent / name).read_bytes())
    return digest.hexdigest()


def baked(kind: str, key: Mapping[str, Any], bake: Callable[[], Arrays]) -> dict[str, np.ndarray]:
    """The arrays of ``bake()``, read from the cache when an undamaged entry of this key is there.

    The entry is written to a temporary file and renamed, so concurrent missions never read half of it.
    A cache that cannot be written (read-only home, full disk) costs time, not correctness.
    """
    text = json.dumps({"code": baking_code_digest(), **key}, sort_keys=True)
    name = f"{kind}-{hashlib.sha256(text.encode()).hexdigest()[:32]}.npz"
    path = cache_home() / "scenes" / name
    stored = _load(path)
    if stored is not None:
        return stored
    arrays = dict(bake())
    with contextlib.suppress(OSError):
        _store(path, arrays)
    return arrays


def _load(path: Path) -> dict[str, np.ndarray] | None:
    try:
        with np.load(path, allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}  # zip CRCs are checked on reading
    except (OSError, ValueError, EOFError, KeyError, zipfile.BadZipFile):
        return None
    return arrays if arrays.pop("complete", None) is not None else None


def _store(path: Path, arrays: Arrays) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=".baking-", suffix=".npz")
    try:
        with os.fdopen(handle, "wb") as file:
            np.savez(file, complete=np.ones(1), **arrays)  # type: ignore[arg-type]
        Path(temporary).replace(path)
    except BaseException:
        with contextlib.suppress(OSError):
            Path(temporary).unlink()
        raise
