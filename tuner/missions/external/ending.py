"""Every process of a mission, found and ended.

A process that adopts orphans (Linux: a child subreaper) keeps below it all that it started, in whatever group or session,
with whatever environment. Only what outlived a keeper that was itself killed is looked for by a mark in its environment.
"""

from __future__ import annotations

import collections
import contextlib
import ctypes
import os
import signal
import time
from collections.abc import Callable, Collection
from pathlib import Path

MARK = "GATETUNE_MISSION"
POLL_S = 0.1
_AFTER_KILL_S = 5.0  # a process of another user, or one that waits for a dead disk, does not end


def adopt_orphans(*, wanted: bool = True) -> None:
    """Have orphans among this process's descendants become its children, or no longer."""
    ctypes.CDLL(None).prctl(36, int(wanted), 0, 0, 0)  # PR_SET_CHILD_SUBREAPER


def end_all(find: Callable[[], list[int]], grace_s: float, main: int | None = None) -> tuple[int, int]:
    """Stop, then kill, every process that ``find`` returns, until it finds none.

    Returns how many besides ``main`` there were, and how many could not be ended.
    """
    found = find()
    others = len([pid for pid in found if pid != main])
    for pid in found:
        _signal(pid, signal.SIGTERM)
        _signal(pid, signal.SIGCONT)  # a stopped process hears SIGTERM only then
    deadline = time.monotonic() + grace_s
    while found and time.monotonic() < deadline:
        time.sleep(min(POLL_S, grace_s))
        found = find()
    deadline = time.monotonic() + _AFTER_KILL_S
    while found and time.monotonic() < deadline:  # what is forked while we look is found the next time
        for pid in found:
            _signal(pid, signal.SIGKILL)
        time.sleep(0.01)
        found = find()
    return others, len(found)


def descendants(root: int, besides: Collection[int] = ()) -> list[int]:
    """Processes below ``root`` that have not ended; without the children ``besides`` and what is below those."""
    children = collections.defaultdict[int, list[tuple[int, bool]]](list)
    for entry in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            state, parent = (entry / "stat").read_text().rpartition(")")[2].split()[:2]
            children[int(parent)].append((int(entry.name), state not in ("Z", "X")))
    found, waiting = list[int](), [root]
    while waiting:
        for pid, alive in children[waiting.pop()]:
            if pid not in besides:
                waiting.append(pid)
                found += [pid] if alive else []
    return found


def marked(mark: str) -> list[int]:
    """Other processes of this user that have not ended, with the mark in their environment."""
    wanted = f"{MARK}={mark}".encode()
    pids = []
    for entry in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError, ValueError):
            if wanted in (entry / "environ").read_bytes().split(b"\0"):
                state = (entry / "stat").read_text().rpartition(")")[2].split()[0]
                if state not in ("Z", "X") and int(entry.name) != os.getpid():
                    pids.append(int(entry.name))
    return pids


def reap_orphans(main: int) -> None:
    """Take note of the end of adopted children, so that they do not pile up; ``main`` is somebody else's to wait for."""
    with contextlib.suppress(ChildProcessError):
        while (ended := os.waitid(os.P_ALL, 0, os.WEXITED | os.WNOHANG | os.WNOWAIT)) is not None:
            if ended.si_pid == main:
                return
            os.waitpid(ended.si_pid, 0)


def _signal(pid: int, number: int) -> None:
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.kill(pid, number)
