"""The files that a mission runs, hashed: nobody should fly another program than before without a word.

They are the files in the mission file's folder that ``command`` or ``function`` name, and the Python and shell files there that
those name in turn. What a program reads besides, and what lies elsewhere, is the user's own business.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Sequence
from pathlib import Path

_SOURCES = (".py", ".sh")
_LARGEST_SOURCE_BYTES = 1_000_000


def program_files(folder: Path, command: Sequence[str], function: str) -> list[Path]:
    """The files of a mission's program below ``folder``, sorted."""
    waiting = [path for word in (*command, function.partition(":")[0]) for path in _named(folder, word)]
    found: set[Path] = set()
    while waiting:
        path = waiting.pop()
        if path in found:
            continue
        found.add(path)
        if path.suffix in _SOURCES and path.stat().st_size <= _LARGEST_SOURCE_BYTES:
            words = set(re.findall(r"[\w./-]+", path.read_text(encoding="utf-8", errors="replace")))
            waiting += [p for word in words for p in _named(folder, word) if p.suffix in _SOURCES]
    return sorted(found)


def program_digest(folder: Path, command: Sequence[str], function: str) -> str:
    """SHA-256 of names and content of `program_files`; ``OSError`` where one cannot be read."""
    digest = hashlib.sha256()
    for path in program_files(folder, command, function):
        with path.open("rb") as file:
            content = hashlib.file_digest(file, "sha256").hexdigest()
        digest.update(f"{path.relative_to(folder)}\0{content}\n".encode())
    return digest.hexdigest()


def _named(folder: Path, word: str) -> list[Path]:
    """The files that a word of a program means: a file, a module or a package of the folder."""
    module = word.partition(".")[0]
    try:
        file = (folder / word).resolve()
        if file.is_file() and file.is_relative_to(folder):
            return [file]
        if (folder / f"{module}.py").is_file():
            return [folder / f"{module}.py"]
        if module and (folder / module / "__init__.py").is_file():
            return list((folder / module).rglob("*.py"))
    except (OSError, ValueError):  # no name of a file
        pass
    return []
