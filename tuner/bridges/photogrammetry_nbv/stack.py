"""The programs of one mission: started in order, watched, and ended with all that they started."""

from __future__ import annotations

import contextlib
import os
import shlex
import signal
import subprocess
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

_GRACE_S = 10.0  # from SIGINT, which ROS programs end on, to SIGKILL
_POLL_S = 0.05


class StackError(Exception):
    """A program that cannot be started or that ended too soon: the machine's failure, in one line."""


class Stack:
    """Running programs by name, in the order in which they were started."""

    def __init__(self, logs: Path) -> None:
        self._logs = logs
        self._running: dict[str, subprocess.Popen[bytes]] = {}

    def start(self, name: str, command: str, folder: Path, environment: Mapping[str, str]) -> None:
        """Start one program in a process group of its own; what it prints goes to ``name``.log."""
        try:
            with self.log(name).open("wb") as log:
                self._running[name] = subprocess.Popen(
                    [os.path.expanduser(word) for word in shlex.split(command)],  # noqa: PTH111
                    cwd=folder,
                    env={**os.environ, **environment},
                    stdin=subprocess.DEVNULL,
                    stdout=log,
                    stderr=subprocess.STDOUT,
                    process_group=0,
                    preexec_fn=_hear_interrupts,
                )
        except (OSError, ValueError) as error:
            raise StackError(
                f"cannot start {name} ({command!r} in {folder}): {getattr(error, 'strerror', None) or error}"
            ) from error

    def log(self, name: str) -> Path:
        """What the program has printed."""
        return self._logs / f"{name}.log"

    def flooded(self, limit_bytes: int) -> str | None:
        """A program that has printed more than that."""
        return next((n for n in self._running if self.log(n).stat().st_size > limit_bytes), None)

    def ended(self) -> dict[str, int]:
        """Exit statuses of the programs that do not run any more."""
        return {name: code for name, p in self._running.items() if (code := p.poll()) is not None}

    def stop(self) -> None:
        """End all, the last started first."""
        for process in reversed(self._running.values()):
            _signal_group(process, signal.SIGINT)
        deadline = time.monotonic() + _GRACE_S
        while len(self.ended()) < len(self._running) and time.monotonic() < deadline:
            time.sleep(_POLL_S)
        for process in self._running.values():
            _signal_group(process, signal.SIGKILL)  # what outlives its parent, too
            process.wait()


def _hear_interrupts() -> None:
    """What is started by a campaign's worker would ignore SIGINT as the worker does."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def _signal_group(process: subprocess.Popen[bytes], number: int) -> None:
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.killpg(process.pid, number)


@contextlib.contextmanager
def running(
    programs: Mapping[str, Mapping[str, Any]],
    environment: Mapping[str, str],
    places: Mapping[str, Any],
    logs: Path,
) -> Iterator[Stack]:
    """All of ``programs`` (``command``, ``folder``), started; ended with the context, however that comes about.

    Raises
    ------
    StackError
        One cannot be started.
    """
    logs.mkdir(parents=True, exist_ok=True)
    stack = Stack(logs)
    try:
        for name, program in programs.items():
            command = str(program.get("command", ""))
            for place, value in places.items():
                command = command.replace("{" + place + "}", str(value))
            stack.start(name, command, Path(str(program.get("folder", "."))).expanduser(), environment)
        yield stack
    finally:
        stack.stop()
