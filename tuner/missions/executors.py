"""Where missions run: processes of this machine.

Each mission has a process group of its own, so that an abort inside a native library, the out-of-memory killer or a
time-out ends one mission and not the campaign.
"""

from __future__ import annotations

import abc
import contextlib
import functools
import json
import os
import select
import selectors
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Self

from nbv import plugins
from nbv.cache import home
from nbv.errors import UserError
from nbv.mission.run_directory import WORKER_LOG
from nbv.safe_files import require
from nbv.threads import ONE_THREAD
from tuner.missions.job import (
    DUMP_SIGNAL,
    MissionJob,
    Trial,
    line_in_log,
    load_trial,
    record_failure,
    remove_earlier_result,
)
from tuner.missions.keeper import children_of, when_parent_ends
from tuner.missions.registry import DEFAULT_FIDELITY, modules_of
from tuner.missions.run_job import EXIT_NOT_WRITABLE


class Executor(abc.ABC):
    """Runs missions, each once; close it after use. One that takes longer than ``timeout_s`` is killed and recorded as ``timeout``."""

    def __init__(self, timeout_s: float) -> None:
        if not timeout_s > 0:
            raise UserError(f"the mission time-out is {timeout_s} s; it must be positive")
        self._timeout_s = timeout_s

    @property
    @abc.abstractmethod
    def capacity(self) -> int:
        """Missions at a time; it may change."""

    def begin(self) -> None:  # noqa: B027  most have nothing to do
        """Get ready while the caller does other things; otherwise the first mission waits for it."""

    @abc.abstractmethod
    def submit(self, job: MissionJob) -> None:
        """Start ``job`` and return at once."""

    @abc.abstractmethod
    def wait_any(self, timeout_s: float) -> list[Trial]:
        """Return the trials that have ended, waiting up to ``timeout_s`` for the first; possibly none."""

    @abc.abstractmethod
    def cancel_all(self) -> None:
        """Kill all missions in flight; they leave no trial."""

    def close(self) -> None:
        """Kill what runs and free all resources."""
        self.cancel_all()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


MAX_WORKERS = 1024
# A mission that has not been started (the server is still importing) gets this much longer.
_START_GRACE_S = 120.0
_DUMP_S = 0.2
# A server that is listened to and says nothing for so long stands still; it beats every `server.BEAT_S`.
_SILENCE_LIMIT_S = 60.0
_SILENCE_LIMIT_AFTER_KILL_S = 10.0
# Sent by a person, a batch system or the out-of-memory killer, never by a mission's own mistake.
_FROM_OUTSIDE = {
    *(signal.SIGKILL, signal.SIGTERM, signal.SIGHUP, signal.SIGINT, signal.SIGQUIT),
    *(signal.SIGXFSZ, signal.SIGXCPU),  # limits such as ulimit -f and -t
}


@dataclass
class _Attempt:
    job: MissionJob
    since: float  # of submission, then of the start
    pid: int | None = None  # of its keeper, once started
    timed_out: bool = False
    stopped: bool = False  # when it was killed for taking too long, somebody had stopped it

    @property
    def elapsed_s(self) -> float:
        return time.monotonic() - self.since


class LocalProcessExecutor(Executor):
    """Missions in processes started by one ``tuner.missions.server``, which imports the modules of the fidelities ``preload`` first."""

    def __init__(
        self,
        workers: int = 1,
        timeout_s: float = 3600.0,
        preload: tuple[str, ...] = (DEFAULT_FIDELITY,),
    ) -> None:
        if workers < 1:
            raise UserError(f"workers is {workers}; it must be at least 1")
        require(workers, MAX_WORKERS, "workers")
        super().__init__(timeout_s)
        self._workers = workers
        self._preload = [name for fidelity in preload for name in modules_of(fidelity)]
        self._attempts: dict[str, _Attempt] = {}
        self._ready: list[Trial] = []
        self._server: subprocess.Popen[bytes] | None = None
        self._server_is_up = False
        self._silent_s = 0.0  # of listening to the server
        self._buffer = b""

    @property
    def capacity(self) -> int:
        return self._workers

    def begin(self) -> None:
        """Let the server import now."""
        self._server = self._server or self._start_server()

    def submit(self, job: MissionJob) -> None:
        remove_earlier_result(job)
        self._attempts[job.id] = _Attempt(job, time.monotonic())
        self._order({"op": "run", "job": job.to_dict()})

    def wait_any(self, timeout_s: float) -> list[Trial]:
        deadline = time.monotonic() + timeout_s
        while not self._ready and self._attempts:
            left = deadline - time.monotonic()
            self._listen(max(0.0, min(left, 0.5)))
            self._kill_overdue()
            if left <= 0:
                break
        ready, self._ready = self._ready, []
        return ready

    def cancel_all(self) -> None:
        self._stop_server()
        self._attempts.clear()
        self._ready.clear()

    def _start_server(self) -> subprocess.Popen[bytes]:
        # Where a library may start threads, the server cannot fork.
        environment = {**plugins.environment(), **ONE_THREAD, "GATETUNE_HOME": str(home().absolute())}
        # Without the current directory: a numpy.py that lies there is not the library.
        environment["PYTHONPATH"] = os.pathsep.join(p for p in sys.path if p)
        self._buffer, self._server_is_up, self._silent_s = b"", False, 0.0
        return subprocess.Popen(
            [sys.executable, "-P", "-m", "tuner.missions.server", *self._preload],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env=environment,
            start_new_session=True,  # Ctrl-C in the terminal reaches the campaign only
            # So that one that somebody stopped, even while it imports, sees the end of its orders.
            preexec_fn=functools.partial(when_parent_ends, signal.SIGCONT),
        )

    def _order(self, message: dict[str, object]) -> None:
        self.begin()
        assert self._server is not None and self._server.stdin is not None
        try:
            self._server.stdin.write(json.dumps(message).encode() + b"\n")
            self._server.stdin.flush()
        except BrokenPipeError:
            self._server_died("the mission server died")

    def _listen(self, timeout_s: float) -> None:
        if self._server is None:
            return
        assert self._server.stdout is not None
        with selectors.DefaultSelector() as selector:  # `select.select` has no descriptor beyond 1,023
            selector.register(self._server.stdout, selectors.EVENT_READ)
            if not selector.select(timeout_s):
                self._silent_s += timeout_s  # not by the clock: this process may have been stopped meanwhile
                return
        self._silent_s = 0.0
        chunk = os.read(self._server.stdout.fileno(), 65536)
        if not chunk:
            self._server_died("the mission server died")
            return
        *lines, self._buffer = (self._buffer + chunk).split(b"\n")
        for line in lines:
            message = json.loads(line)
            self._server_is_up = True
            if message["event"] == "started" and message["id"] in self._attempts:
                # The server may have been importing until now; that is not the mission's time.
                attempt = self._attempts[message["id"]]
                attempt.since, attempt.pid = time.monotonic(), message["pid"]
            if message["event"] == "exited" and message["id"] in self._attempts:
                self._record_end(
                    self._attempts.pop(message["id"]), message["status"], message.get("error", "")
                )

    def _record_end(self, attempt: _Attempt, status: int | None, error: str) -> None:
        job, wall_s = attempt.job, attempt.elapsed_s
        trial = load_trial(job, wall_s)
        if trial is None:
            reason, message = self._verdict(attempt, status, error)
            trial = job.failed(reason, message, wall_s)
            with contextlib.suppress(OSError):  # so that the directory tells its own story
                record_failure(job.to_dict(), reason, message)
        self._ready.append(trial)

    def _verdict(self, attempt: _Attempt, status: int | None, error: str) -> tuple[str, str]:
        """Return why a mission left nothing, as reason and message; ``status`` is None where the server died."""
        log = attempt.job.directory / WORKER_LOG
        if status is None:
            return ("server_lost" if attempt.pid else "not_started"), error
        if attempt.timed_out and attempt.stopped:
            return "worker_stopped", f"somebody stopped its process (SIGSTOP); see {log}"
        if attempt.timed_out:
            return (
                "timeout",
                f"killed after {self._timeout_s:g} s, the limit of a mission (--timeout-s){line_in_log(attempt.job)}; see {log}",
            )
        if status == EXIT_NOT_WRITABLE:
            return "output_not_writable", f"could not write to {attempt.job.directory}; is the disk full?"
        if status >= 0:
            return f"worker_died: exit {status}", f"ended without a result; see {log}"
        name = signal.Signals(-status).name if -status in set(signal.Signals) else "unknown"
        if -status in _FROM_OUTSIDE:
            return (
                f"worker_killed: signal {-status}",
                f"somebody sent {name}, or memory or another limit was reached; see {log}",
            )
        return f"worker_died: signal {-status}", f"killed by {name}; see {log}"

    def _kill_overdue(self) -> None:
        for job_id, attempt in list(self._attempts.items()):
            limit_s = self._timeout_s + (_START_GRACE_S if attempt.pid is None else 0.0)
            if job_id in self._attempts and not attempt.timed_out and attempt.elapsed_s > limit_s:
                attempt.timed_out, attempt.stopped = True, _is_stopped(attempt.pid)
                _dump(attempt.pid)
                self._order({"op": "kill", "id": job_id})
        overdue = any(attempt.timed_out for attempt in self._attempts.values())
        limit_s = _SILENCE_LIMIT_AFTER_KILL_S if overdue else _SILENCE_LIMIT_S
        if self._silent_s > (limit_s if self._server_is_up else _START_GRACE_S):
            self._server_died(f"the mission server stood still for {self._silent_s:.0f} s")

    def _server_died(self, error: str) -> None:
        self._stop_server(patience_s=1.0)
        attempts, self._attempts = self._attempts, {}
        for attempt in attempts.values():
            _wait_for_end(attempt.pid)
            self._record_end(attempt, None, error)

    def _stop_server(self, patience_s: float = 10.0) -> None:
        server, self._server = self._server, None
        if server is None:
            return
        assert server.stdin is not None and server.stdout is not None
        if not (self._server_is_up or select.select([server.stdout], [], [], 0.0)[0]):
            server.kill()  # it is still importing: no mission has begun
        with contextlib.suppress(BrokenPipeError):
            server.stdin.close()  # the server kills its missions and ends
        try:
            server.wait(timeout=patience_s)
        except subprocess.TimeoutExpired:
            server.kill()
            server.wait()
        server.stdout.close()


def _is_stopped(keeper: int | None) -> bool:
    with contextlib.suppress(OSError):
        stats = [Path(f"/proc/{pid}/stat").read_text() for pid in (keeper, *children_of(keeper)[:1])]
        return any(stat.rpartition(")")[2].split()[0] == "T" for stat in stats)
    return False


def _dump(keeper: int | None) -> None:
    """Let a mission that hangs write into its log where it is."""
    for mission in children_of(keeper)[:1]:
        with contextlib.suppress(ProcessLookupError):
            os.kill(mission, DUMP_SIGNAL)
            time.sleep(_DUMP_S)


def _wait_for_end(pid: int | None) -> None:
    """Wait until a mission whose server has died has been killed by the system, so that it is not run twice at once."""
    deadline = time.monotonic() + 5.0
    while pid is not None and Path(f"/proc/{pid}").exists() and time.monotonic() < deadline:
        time.sleep(0.01)


def local_executor(fidelity: str, workers: int | None, timeout_s: float) -> LocalProcessExecutor:
    """Return processes for missions, one per core unless told otherwise."""
    count = len(os.sched_getaffinity(0)) if workers is None else workers
    return LocalProcessExecutor(count, timeout_s, (fidelity,))
