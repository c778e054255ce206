"""A command with a time limit that leaves no process behind and cannot fill the disk with its log.

Whatever the command starts inherits a mark in its environment. At the end, and at a time-out, everything that carries
the mark is told to stop and, after a grace period, killed: children that moved to another process group or session too.
"""

from __future__ import annotations

import contextlib
import os
import selectors
import signal
import subprocess
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from nbv.errors import UserError

MARK = "GATETUNE_MISSION"
LARGEST_LOG_BYTES = 5_000_000
_READ_BYTES = 65536
_POLL_S = 0.1


@dataclass(frozen=True)
class Ended:
    """How a command ended."""

    status: int  # exit status; negative: the signal that ended it
    wall_s: float
    timed_out: bool
    left_behind: int  # processes that had to be ended after it
    log_cut: bool  # whether it wrote more than was kept


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
        Identifies the mission; whatever still carries it from an earlier attempt is ended first.

    Raises
    ------
    UserError
        The command does not exist or may not be run.
    """
    end_marked(mark, stop_grace_s)
    with _guarded(mark, stop_grace_s):
        return _run(command, folder, environment, mark, log, time_limit_s, stop_grace_s, log_limit_bytes)


def _run(
    command: Sequence[str],
    folder: Path,
    environment: Mapping[str, str],
    mark: str,
    log: Path,
    time_limit_s: float,
    stop_grace_s: float,
    log_limit_bytes: int,
) -> Ended:
    started = time.monotonic()
    try:
        process = subprocess.Popen(
            list(command),
            cwd=folder,
            env={**os.environ, **environment, MARK: mark},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            start_new_session=True,  # no terminal to ask for a password
        )
    except OSError as error:
        raise UserError(
            f"cannot run {command[0]!r} in {folder}: {error.strerror or error}; mend 'command' in the mission file"
        ) from error
    timed_out = False
    try:
        written, cut = _follow(process, log, started + time_limit_s, log_limit_bytes)
        timed_out = process.poll() is None
    finally:
        left = end_marked(mark, stop_grace_s, main=process.pid)
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        status = process.wait()
        assert process.stdout is not None
        process.stdout.close()
    if cut:
        with log.open("ab") as file:
            file.write(f"\n[gatetune: the log was cut after {written} bytes]\n".encode())
    return Ended(status, time.monotonic() - started, timed_out, left, cut)


def _follow(process: subprocess.Popen[bytes], log: Path, deadline: float, limit: int) -> tuple[int, bool]:
    """Copy the output until the process ends or the deadline; bytes kept, and whether more came."""
    assert process.stdout is not None
    handle, written, cut = process.stdout.fileno(), 0, False
    os.set_blocking(handle, False)
    with log.open("wb") as file, selectors.DefaultSelector() as selector:
        selector.register(handle, selectors.EVENT_READ)
        while True:
            ended = process.poll() is not None
            open_, chunk = True, b""
            if selector.get_map() and selector.select(0.0 if ended else _POLL_S):
                chunk = os.read(handle, _READ_BYTES)
                open_ = bool(chunk)
            elif not selector.get_map():
                with contextlib.suppress(subprocess.TimeoutExpired):
                    process.wait(_POLL_S)
            if chunk:
                file.write(chunk[: max(0, limit - written)])
                cut = cut or written + len(chunk) > limit
                written = min(limit, written + len(chunk))
            if not open_:
                selector.unregister(handle)
            # A child that outlives the command may keep the pipe: what has been read is enough then.
            if ended and not chunk:
                return written, cut
            if time.monotonic() > deadline:
                return written, cut


@contextlib.contextmanager
def _guarded(mark: str, grace_s: float) -> Iterator[None]:
    """Should this process be killed meanwhile, a child of it ends all that carries ``mark``.

    The child also keeps what this process has locked, until that is done.
    """
    read, write = os.pipe()
    pid = os.fork()
    if pid == 0:
        try:
            os.setsid()
            for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
                signal.signal(number, signal.SIG_IGN)
            os.close(write)
            if not os.read(read, 1):
                end_marked(mark, grace_s)
        finally:
            os._exit(0)
    os.close(read)
    try:
        yield
    finally:
        os.write(write, b".")
        os.close(write)
        os.waitpid(pid, 0)


def end_marked(mark: str, grace_s: float, main: int | None = None) -> int:
    """Stop, then kill, every process that carries ``mark``; how many besides ``main`` there were."""
    found = _marked(mark)
    others = len([pid for pid in found if pid != main])
    for pid in found:
        _signal(pid, signal.SIGTERM)
        _signal(pid, signal.SIGCONT)  # a stopped process hears SIGTERM only then
    deadline = time.monotonic() + grace_s
    while found and time.monotonic() < deadline:
        time.sleep(min(_POLL_S, grace_s))
        found = _marked(mark)
    while found:  # what is forked while we look is found the next time
        for pid in found:
            _signal(pid, signal.SIGKILL)
        time.sleep(0.01)
        found = _marked(mark)
    return others


def _marked(mark: str) -> list[int]:
    """Processes of this user, not yet ended, with the mark in their environment (Linux)."""
    wanted = f"{MARK}={mark}".encode()
    pids = []
    for entry in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError, ValueError):
            if wanted in (entry / "environ").read_bytes().split(b"\0"):
                state = (entry / "stat").read_text().rpartition(")")[2].split()[0]
                if state not in ("Z", "X") and int(entry.name) != os.getpid():
                    pids.append(int(entry.name))
    return pids


def _signal(pid: int, number: int) -> None:
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.kill(pid, number)
