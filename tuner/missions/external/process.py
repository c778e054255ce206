"""A command with a time limit that leaves no process behind and cannot fill the disk with its log.

A keeper, a process between us and the command, adopts whatever the command's processes leave behind (Linux: a child subreaper),
in whatever group or session, with whatever environment. At the end or at a time-out it tells all of them to stop and, after a
grace period, kills them; should we be killed, it does so at once. Only what outlived a keeper that was itself killed is looked
for by a mark in its environment.
"""

from __future__ import annotations

import collections
import contextlib
import ctypes
import multiprocessing
import os
import selectors
import signal
import subprocess
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import IO

from nbv.errors import UserError

LARGEST_LOG_BYTES = 5_000_000
_MARK = "GATETUNE_MISSION"
_POLL_S = 0.1
_AFTER_KILL_S = 5.0  # a process of another user, or one that waits for a dead disk, does not end
_READ_BYTES = 65536


@dataclass(frozen=True)
class Ended:
    """How a command ended."""

    status: int  # exit status; negative: the signal that ended it
    wall_s: float
    timed_out: bool
    left_behind: int  # processes that had to be ended after it
    survived: int = 0  # processes that could not be ended, such as another user's


def run_command(
    command: Sequence[str],
    folder: Path,
    environment: Mapping[str, str],
    mark: str,
    log: Path,
    time_limit_s: float,
    stop_grace_s: float = 5.0,
    log_limit_bytes: int = LARGEST_LOG_BYTES,
) -> Ended:
    """Run ``command`` in ``folder`` until it ends or its time is over; nothing that it started is left.

    It reads nothing: a question for a password ends at once. What it prints goes to ``log``, up to the limit.

    Parameters
    ----------
    command, folder, environment
        What runs, where, and what is added to our environment.
    mark
        Identifies the mission; whatever carries it from an attempt whose keeper was killed is ended first.
    log, log_limit_bytes
        Where its output goes, and how much of it.
    time_limit_s, stop_grace_s
        When it is told to stop, and how much later it is killed.

    Raises
    ------
    UserError
        The command does not exist or may not be run.
    """
    end_all(lambda: marked(mark), stop_grace_s)
    started, us, ours = time.monotonic(), os.getpid(), descendants(os.getpid())

    def keep(answer: Connection) -> None:
        _be_keeper()
        try:
            with _opened(log) as file:  # before the command could put something else in its place
                process = _started(command, folder, {**os.environ, **environment, _MARK: mark})
                try:
                    _follow(process, file, started + time_limit_s, log_limit_bytes, us)
                    timed_out = process.poll() is None
                finally:
                    left, survived = end_all(lambda: descendants(os.getpid()), stop_grace_s, process.pid)
            answer.send(Ended(process.wait(), time.monotonic() - started, timed_out, left, survived))
        except (UserError, OSError) as error:  # the disk with the log may be full
            answer.send(error)

    _adopt_orphans()  # should the mission kill its keeper
    try:
        ended = _answer_of_child(keep)
        if ended is None:
            left, survived = end_all(lambda: descendants(os.getpid(), ours), stop_grace_s)
            return Ended(-signal.SIGKILL, time.monotonic() - started, False, left, survived)
    finally:
        _adopt_orphans(wanted=False)
    if isinstance(ended, Exception):
        raise ended
    return ended


def _answer_of_child(keep: Callable[[Connection], None]) -> Ended | Exception | None:
    """What ``keep``, in a child of this process, sent; None where that child was killed."""
    fork = multiprocessing.get_context("fork")
    answer, theirs = fork.Pipe(duplex=False)
    child = fork.Process(target=keep, args=(theirs,))
    child.start()
    theirs.close()
    try:
        found: Ended | Exception = answer.recv()
        return found
    except EOFError:
        return None
    finally:
        answer.close()
        child.join()


def _be_keeper() -> None:
    os.setsid()
    _adopt_orphans()
    signal.set_wakeup_fd(-1)
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, lambda *_: None)  # not ignored: a command would inherit that


def _started(command: Sequence[str], folder: Path, environment: Mapping[str, str]) -> subprocess.Popen[bytes]:
    try:
        return subprocess.Popen(
            list(command),
            cwd=folder,
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            start_new_session=True,  # no terminal to ask for a password
        )
    except (OSError, ValueError) as error:
        why = getattr(error, "strerror", None) or error
        raise UserError(
            f"cannot run {command[0]!r} in {folder}: {why}; mend 'command' in the mission file"
        ) from error


def _opened(log: Path) -> IO[bytes]:
    """The log, new; a link that lies in its place is not followed."""
    flags = os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_NOFOLLOW | os.O_CLOEXEC
    return os.fdopen(os.open(log, flags, 0o644), "wb", buffering=0)


def _follow(
    process: subprocess.Popen[bytes], log: IO[bytes], deadline: float, limit: int, parent: int
) -> None:
    """Copy the output, up to the limit, until the process ends, the deadline, or the end of our parent."""
    assert process.stdout is not None
    handle, written, cut = process.stdout.fileno(), 0, False
    os.set_blocking(handle, False)
    end = os.pidfd_open(process.pid)
    with selectors.DefaultSelector() as selector, contextlib.closing(os.fdopen(end, "rb", buffering=0)):
        for descriptor in (handle, end):
            selector.register(descriptor, selectors.EVENT_READ)
        while True:
            ended = process.poll() is not None
            ready = [key.fd for key, _ in selector.select(0.0 if ended else _POLL_S)]
            chunk = os.read(handle, _READ_BYTES) if handle in ready else b""
            if handle in ready and not chunk:
                selector.unregister(handle)
            if chunk:
                log.write(chunk[: max(0, limit - written)])
                cut = cut or written + len(chunk) > limit
                written = min(limit, written + len(chunk))
            # A child that outlives the command may keep the pipe: what has been read is enough then.
            if (ended and not chunk) or os.getppid() != parent or time.monotonic() > deadline:
                break
            _reap_orphans(process.pid)
    if cut:
        log.write(f"\n[gatetune: the log was cut after {written} bytes]\n".encode())


def _adopt_orphans(*, wanted: bool = True) -> None:
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
        time.sleep(min(_POLL_S, grace_s))
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
            state, parent = _state_and_parent(entry)
            children[parent].append((int(entry.name), state not in "ZX"))
    found, waiting = list[int](), [root]
    while waiting:
        for pid, alive in children[waiting.pop()]:
            if pid not in besides:
                waiting.append(pid)
                found += [pid] if alive else []
    return found


def marked(mark: str) -> list[int]:
    """Other processes of this user that have not ended, with the mark in their environment."""
    wanted = f"{_MARK}={mark}".encode()
    pids = []
    for entry in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError, ValueError):
            is_it = wanted in (entry / "environ").read_bytes().split(b"\0")
            if is_it and _state_and_parent(entry)[0] not in "ZX" and int(entry.name) != os.getpid():
                pids.append(int(entry.name))
    return pids


def _state_and_parent(process: Path) -> tuple[str, int]:
    state, parent = (process / "stat").read_text().rpartition(")")[2].split()[:2]
    return state, int(parent)


def _reap_orphans(main: int) -> None:
    """Take note of the end of adopted children, so that they do not pile up; ``main`` is somebody else's to wait for."""
    with contextlib.suppress(ChildProcessError):
        while (ended := os.waitid(os.P_ALL, 0, os.WEXITED | os.WNOHANG | os.WNOWAIT)) is not None:
            if ended.si_pid == main:
                return
            os.waitpid(ended.si_pid, 0)


def _signal(pid: int, number: int) -> None:
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.kill(pid, number)
