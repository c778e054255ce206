"""A command with a time limit that leaves no process behind and cannot fill the disk with its log.

A keeper, a process between us and the command, adopts whatever the command's processes leave behind, and at the end or at a
time-out tells all of them to stop and, after a grace period, kills them. Should we be killed, it does so at once.
"""

from __future__ import annotations

import contextlib
import dataclasses
import json
import os
import selectors
import signal
import subprocess
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, NoReturn

from nbv.errors import UserError
from nbv.safe_files import parse_json
from tuner.missions.external.ending import (
    MARK,
    POLL_S,
    adopt_orphans,
    descendants,
    end_all,
    marked,
    reap_orphans,
)

LARGEST_LOG_BYTES = 5_000_000
_READ_BYTES = 65536


@dataclass(frozen=True)
class Ended:
    """How a command ended."""

    status: int  # exit status; negative: the signal that ended it
    wall_s: float
    timed_out: bool
    left_behind: int  # processes that had to be ended after it
    log_cut: bool  # whether it wrote more than was kept
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
    mark
        Identifies the mission; whatever carries it from an attempt whose keeper was killed is ended first.

    Raises
    ------
    UserError
        The command does not exist or may not be run.
    """
    end_all(lambda: marked(mark), stop_grace_s)
    started, ours = time.monotonic(), descendants(os.getpid())

    def fly(life: int) -> Ended:
        with _opened(log) as file:  # before the command could put something else in its place
            process = _started(command, folder, {**os.environ, **environment, MARK: mark})
            return _kept(process, file, started, time_limit_s, stop_grace_s, log_limit_bytes, life)

    adopt_orphans()  # should the mission kill its keeper
    try:
        said = _by_keeper(fly)
        if not said:
            left, survived = end_all(lambda: descendants(os.getpid(), ours), stop_grace_s)
            wall_s = time.monotonic() - started
            return Ended(-signal.SIGKILL, wall_s, False, left, False, survived)
    finally:
        adopt_orphans(wanted=False)
    found = parse_json(said.decode(), "the answer of a mission's keeper")
    if "error" in found:
        raise UserError(found["error"])
    if "os_error" in found:
        raise OSError(*found["os_error"])
    return Ended(**found)


def _by_keeper(fly: Callable[[int], Ended]) -> bytes:
    """What ``fly`` returned as JSON, called in a child of this process; empty where that child was killed.

    ``fly`` gets a descriptor that ends with this process. The child also keeps what this process has locked.
    """
    life, ours = os.pipe()
    answer, theirs = os.pipe()
    pid = os.fork()
    if pid == 0:
        os.close(ours)
        os.close(answer)
        _be_keeper(fly, life, theirs)
    os.close(life)
    os.close(theirs)
    try:
        with os.fdopen(answer, "rb") as file:
            return file.read()
    finally:
        os.close(ours)
        os.waitpid(pid, 0)


def _be_keeper(fly: Callable[[int], Ended], life: int, answer: int) -> NoReturn:
    try:
        os.setsid()
        adopt_orphans()
        signal.set_wakeup_fd(-1)
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            signal.signal(number, lambda *_: None)  # not ignored: a command would inherit that
        try:
            found = dataclasses.asdict(fly(life))
        except UserError as error:
            found = {"error": str(error)}
        except OSError as error:  # the disk with the log is full
            found = {"os_error": [error.errno, error.strerror]}
        os.write(answer, json.dumps(found).encode())
    finally:
        os._exit(0)


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


def _kept(
    process: subprocess.Popen[bytes],
    log: IO[bytes],
    started: float,
    time_limit_s: float,
    stop_grace_s: float,
    log_limit_bytes: int,
    life: int,
) -> Ended:
    timed_out = cut = False
    try:
        cut = _follow(process, log, started + time_limit_s, log_limit_bytes, life)
        timed_out = process.poll() is None
    finally:
        left, survived = end_all(lambda: descendants(os.getpid()), stop_grace_s, process.pid)
        status = process.wait()
    return Ended(status, time.monotonic() - started, timed_out, left, cut, survived)


def _opened(log: Path) -> IO[bytes]:
    """The log, new; a link that lies in its place is not followed."""
    flags = os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_NOFOLLOW | os.O_CLOEXEC
    return os.fdopen(os.open(log, flags, 0o644), "wb", buffering=0)


def _follow(process: subprocess.Popen[bytes], log: IO[bytes], deadline: float, limit: int, life: int) -> bool:
    """Copy the output until the process ends, the deadline, or the end of ``life``; whether more came than ``limit``."""
    assert process.stdout is not None
    handle, written, cut = process.stdout.fileno(), 0, False
    os.set_blocking(handle, False)
    end = os.pidfd_open(process.pid)
    with selectors.DefaultSelector() as selector, contextlib.closing(os.fdopen(end, "rb", buffering=0)):
        for descriptor in (handle, life, end):
            selector.register(descriptor, selectors.EVENT_READ)
        while True:
            ended = process.poll() is not None
            ready = [key.fd for key, _ in selector.select(0.0 if ended else POLL_S)]
            chunk = os.read(handle, _READ_BYTES) if handle in ready else b""
            if handle in ready and not chunk:
                selector.unregister(handle)
            if chunk:
                log.write(chunk[: max(0, limit - written)])
                cut = cut or written + len(chunk) > limit
                written = min(limit, written + len(chunk))
            # A child that outlives the command may keep the pipe: what has been read is enough then.
            if (ended and not chunk) or life in ready or time.monotonic() > deadline:
                break
            reap_orphans(process.pid)
    if cut:
        log.write(f"\n[gatetune: the log was cut after {written} bytes]\n".encode())
    return cut
