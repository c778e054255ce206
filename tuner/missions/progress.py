"""A mission in flight says what it is doing: one line in a file of its directory, for a live display."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import Any

from tuner.missions.registry import DEFAULT_FIDELITY, PHOTOGRAPHS

PROGRESS_FILE = "now"
_LONGEST = 40  # characters that are read


class Progress:
    """A `nbv.mission.function.Log` that keeps one line up to date; a directory that cannot be written has none."""

    def __init__(self, directory: Path) -> None:
        self._file = directory / PROGRESS_FILE
        self._seeds = self._budget = 0

    def __call__(self, event: str, facts: dict[str, Any]) -> None:
        """Write what comes after the event."""
        if event == "start":
            self._seeds, self._budget = facts["seeds"], facts["budget"]
            self._write("scene")
        elif event == "seed":
            done = facts["index"] + 1
            self._write(f"photograph {done}/{self._seeds}" if done < self._seeds else "seed model")
        elif event in ("seed-model", "capture"):
            self._write(f"view {facts.get('iteration', -1) + 2}/{self._budget}")
        elif event in ("dense", "metrics"):
            self._write({"dense": "dense cloud", "metrics": "errors"}[event])

    def _write(self, text: str) -> None:
        with contextlib.suppress(OSError):
            self._file.write_text(text)

    def end(self) -> None:
        """Remove the line."""
        with contextlib.suppress(OSError):
            self._file.unlink()


def log_of(fidelity: str, directory: Path) -> Progress | None:
    """Return what writes the progress of a mission; None for fidelities that take a second, or are not ours."""
    return Progress(directory) if fidelity in (DEFAULT_FIDELITY, PHOTOGRAPHS) else None


def progress_of(directory: Path) -> str:
    """Return the progress line of the mission in ``directory``; empty where there is none."""
    try:
        with (directory / PROGRESS_FILE).open() as file:
            return file.read(_LONGEST)
    except (OSError, UnicodeDecodeError):
        return ""
