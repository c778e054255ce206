"""The files that a mission runs, hashed: nobody should fly another program than before without a word.

They are the files that ``command`` or ``function`` names (of the system's own programs none), and the Python and shell files in
the mission file's folder that those name in turn. What a program reads besides is the user's own business.
"""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Iterator, Sequence
from pathlib import Path

_SOURCES = (".py", ".sh")
_LARGEST_SOURCE_BYTES = 1_000_000


def program_files(folder: Path, command: Sequence[str], function: str) -> list[Path]:
    """The files of a mission's program, sorted; ``folder`` is absolute, the mission file's."""
    waiting = [
        path
        for word in (*command, function.partition(":")[0])
        for path in _named(folder, word)
        if path.suffix in _SOURCES or not Path(word).is_absolute()
    ]
    found: set[Path] = set()
    while waiting:
        path = waiting.pop()
        if path in found:
            continue
        found.add(path)
        if path.suffix in _SOURCES and path.stat().st_size <= _LARGEST_SOURCE_BYTES:
            words = set(re.findall(r"[\w./-]+", path.read_text(encoding="utf-8", errors="replace")))
            # Python looks for modules beside the script, a shell in the folder where it runs.
            named = (
                file for word in words for place in {folder, path.parent} for file in _named(place, word)
            )
            waiting += [file for file in named if file.suffix in _SOURCES and file.is_relative_to(folder)]
    return sorted(found)


def program_digest(folder: Path, command: Sequence[str], function: str) -> str:
    """SHA-256 of names and content of `program_files`; ``OSError`` where one cannot be read."""
    digest = hashlib.sha256()
    for path in program_files(folder, command, function):
        with path.open("rb") as file:
            content = hashlib.file_digest(file, "sha256").hexdigest()
        digest.update(f"{os.path.relpath(path, folder)}\0{content}\n".encode())
    return digest.hexdigest()


def _named(place: Path, word: str) -> Iterator[Path]:
    """The files that a word of a program means: a file, a module, or the modules of a package."""
    names = {word.partition(".")[0], word.replace(".", "/")} if re.fullmatch(r"\w+(\.\w+)*", word) else ()
    try:
        for name in (word, *(f"{name}.py" for name in names)):
            if (file := Path(os.path.normpath(place / name))).is_file():
                yield file
        for package in (place / name for name in names):
            if package.is_dir():
                yield from package.glob("**/*.py" if (package / "__init__.py").is_file() else "*.py")
    except (OSError, ValueError):  # no name of a file
        return
