"""A hash that this machine alone can make, for what is to be told apart without being named."""

from __future__ import annotations

import contextlib
import functools
import hashlib
import os
import secrets
from pathlib import Path

from nbv.cache.store import home

KEY_FILE = "machine.key"  # in the user's folder
_of_coordinator = b""


def keyed(text: str) -> str:
    """64 hex digits of ``text`` and `machine_key`; empty for an empty text."""
    return hashlib.blake2b(text.encode(), key=machine_key(), digest_size=32).hexdigest() if text else ""


def machine_key() -> bytes:
    """This machine's random key, or that of the coordinator whose missions run here."""
    return _of_coordinator or _stored_key(home() / KEY_FILE)


def use_machine_key(key: bytes) -> None:
    """Take a coordinator's key: its missions draw the same on all machines."""
    global _of_coordinator
    _of_coordinator = key


@functools.cache
def _stored_key(path: Path) -> bytes:
    """The key in ``path``, made where there is none; one for this process alone where none can be stored."""
    made, draft = secrets.token_bytes(32), path.with_name(f".{KEY_FILE}.{secrets.token_hex(8)}")
    with contextlib.suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        draft.touch(mode=0o600)
        draft.write_bytes(made)
        with contextlib.suppress(OSError):  # another process was first
            os.link(draft, path)
        draft.unlink()
    with contextlib.suppress(OSError):
        return path.read_bytes()[:64] or made
    return made
