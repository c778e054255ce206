"""Stands between the server and one mission: keeps what the mission prints within a limit, and ends all that it has started.

A mission may run another's planner, which may print without end, leave processes behind or kill its parent. So its parent is
a process of its own, the keeper; whatever it starts, daemons included, becomes the keeper's child once its own parent has
ended. When the mission ends, or the server does, however that ends, the keeper kills all of it and ends the same way.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import selectors
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import NoReturn

_LIBC = ctypes.CDLL(None)  # before a fork, after which little is safe
LOG_BYTES = 200_000  # of what a mission prints: as much of the beginning, and of each attempt's end
PATIENCE_S = 2.0  # with killed processes that the system has not ended yet
_FIRST_TO_GO = "800"  # of 1000: where memory runs out a mission ends, not its server nor the coordinator


def keep(mission: Callable[[], int], log: int, server: int) -> NoReturn:
    """Become the keeper of ``mission`` in a forked process of the process ``server``; its output goes to the descriptor ``log``."""
    status = 1
    try:
        with contextlib.suppress(PermissionError):  # it leads a session already
            os.setsid()
        adopt_orphans()
        woken, wake = os.pipe()
        for end in (woken, wake):
            os.set_blocking(end, False)
        asked_to_end: list[int] = []
        signal.set_wakeup_fd(wake)
        signal.signal(signal.SIGCHLD, lambda *_: None)
        signal.signal(signal.SIGTERM, lambda number, _: asked_to_end.append(number))
        when_parent_ends(signal.SIGTERM)
        printed, output = os.pipe()
        pid = os.fork()
        if not pid:
            _run(mission, output, (log, woken, wake, printed))
        os.close(output)
        os.set_blocking(printed, False)
        for standard in (1, 2):
            os.dup2(log, standard)
        said = _Limited(log)
        selector = selectors.DefaultSelector()
        selector.register(woken, selectors.EVENT_READ)
        selector.register(printed, selectors.EVENT_READ)
        ended = 0
        while not (ended or asked_to_end or os.getppid() != server):
            for key, _ in selector.select():
                if key.fd == woken:
                    os.read(woken, 4096)
                elif not said.take(printed):
                    selector.unregister(printed)
            ended, code = os.waitpid(pid, os.WNOHANG)
            status = os.waitstatus_to_exitcode(code) if ended else -signal.SIGTERM
        end_children()
        while said.take(printed):  # nobody is left who could add to it
            pass
        said.close()
    finally:
        _end_as(status)


def _run(mission: Callable[[], int], output: int, others: tuple[int, ...]) -> NoReturn:
    status = 1
    try:
        when_parent_ends(signal.SIGKILL)
        signal.set_wakeup_fd(-1)
        for number in (signal.SIGINT, signal.SIGCHLD, signal.SIGTERM):
            signal.signal(number, signal.SIG_DFL)
        os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
        for standard in (1, 2):
            os.dup2(output, standard)
        for descriptor in (output, *others):
            if descriptor > 2:
                os.close(descriptor)
        with contextlib.suppress(OSError):
            Path("/proc/self/oom_score_adj").write_text(_FIRST_TO_GO)
        status = mission()
        sys.stdout.flush()
        sys.stderr.flush()
    finally:
        os._exit(status)


class _Limited:
    """What is printed, within limits: the beginning goes into the log at once, of the rest the end when all has been printed."""

    def __init__(self, log: int) -> None:
        self._log, self._end, self._left_out = log, b"", 0
        self._room = max(0, LOG_BYTES - os.fstat(log).st_size)  # an earlier attempt may have written

    def take(self, printed: int) -> bool:
        """Read what is there; False where there is nothing, or never will be."""
        try:
            chunk = os.read(printed, 65536)
        except BlockingIOError:
            return False
        self._write(chunk[: self._room])
        kept = self._end + chunk[self._room :]
        self._room = max(0, self._room - len(chunk))
        self._left_out += max(0, len(kept) - LOG_BYTES)
        self._end = kept[-LOG_BYTES:]
        return bool(chunk)

    def close(self) -> None:
        if self._left_out:
            self._write(b"\n[%d bytes left out]\n" % self._left_out)
        self._write(self._end)

    def _write(self, content: bytes) -> None:
        with contextlib.suppress(OSError):  # a full disk costs the log
            os.write(self._log, content)


def _end_as(status: int) -> NoReturn:
    """End with the exit status, or by the signal, that the mission ended with."""
    if status < 0:
        with contextlib.suppress(OSError, ValueError):
            signal.signal(-status, signal.SIG_DFL)
        with contextlib.suppress(OSError):
            os.kill(os.getpid(), -status)
    os._exit(status if status >= 0 else 128 - status)


def end_children(but: frozenset[int] = frozenset()) -> None:
    """Kill this process's children, those that it has adopted included, ``but`` some, and see them end."""
    deadline = time.monotonic() + PATIENCE_S
    while (others := set(children_of(os.getpid())) - but) and time.monotonic() < deadline:
        for pid in others:
            with contextlib.suppress(ProcessLookupError, ChildProcessError):
                os.kill(pid, signal.SIGKILL)
                os.waitpid(pid, os.WNOHANG)
        time.sleep(0.005)


def children_of(parent: int | None) -> list[int]:
    """Return the process ids of a process's children, its first one first; none where it has ended, or no list of them is kept."""
    try:
        return [int(pid) for pid in Path(f"/proc/{parent}/task/{parent}/children").read_text().split()]
    except OSError:
        return []


def adopt_orphans() -> None:
    """Ask Linux to make this process the parent of what its descendants leave behind, daemons included."""
    _LIBC.prctl(36, 1, 0, 0, 0)  # PR_SET_CHILD_SUBREAPER


def when_parent_ends(number: signal.Signals) -> None:
    """Ask Linux to send this process a signal when its parent has ended, however that ends; an exec leaves that as it is."""
    _LIBC.prctl(1, number)  # PR_SET_PDEATHSIG
