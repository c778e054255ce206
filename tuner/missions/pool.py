"""Where missions run: processes of this machine; `tuner.missions.dask_pool` has workers of other machines.

A process takes one mission after another, and ends with the first that fails. It is forked from Python's own fork server, which has
loaded what missions import. A crash, a hang or the end of memory ends one mission, which fails with its reason. Of libraries,
`concurrent.futures` and loky lose all missions that run beside one that crashes, and have no time limit; pebble has both, but leaves
what a hung mission has started, ends a process that does not listen three seconds late, and runs the user's script again.
"""

from __future__ import annotations

import abc
import contextlib
import errno
import faulthandler
import functools
import multiprocessing
import os
import signal
import sys
import threading
import time
import traceback
import types
from collections.abc import Callable, Iterator
from concurrent.futures import Future, InvalidStateError
from multiprocessing import forkserver, resource_tracker
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any, Self

from nbv import plugins
from nbv.errors import MissionFailure, UserError
from nbv.mission.run_directory import RESULT, WORKER_LOG
from nbv.process import ONE_THREAD
from nbv.safe_files import write_atomic
from tuner.missions.job import MissionJob, Trial, load_trial, record_failure, remove_earlier_result
from tuner.missions.registry import DEFAULT_FIDELITY, kind_on, modules_of

MAX_WORKERS = 256
MAX_TIMEOUT_S = 2e6  # 23 days: the system waits no longer
_MISSIONS_OF_A_PROCESS = 20  # then another takes its place: libraries keep memory
_DUMP_S = 0.5  # in which a mission that takes too long writes into its log where it is
_MEMORY_SCORE = "800"  # of 1000: where memory runs out the system ends a mission, not the coordinator
_END_S = 10.0  # of patience with a killed process
_FAILED = 1
_NOT_WRITABLE = 74  # EX_IOERR: a mission could not even write why it failed
_SERVER_LOST = 255  # what Python says where the fork server ended
_FULL = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}  # the last: a limit such as ulimit -f
_MACHINE_ERRORS = {
    *(errno.EACCES, errno.EPERM, errno.ENODEV, errno.ENXIO, errno.ETIMEDOUT, errno.EIO),
    *(errno.EMFILE, errno.ENFILE, errno.ENOMEM, errno.EAGAIN, errno.EROFS, errno.ESTALE),
}
_context = multiprocessing.get_context("forkserver")
_processes = threading.Lock()  # whoever starts one looks after the ends of all others


class Executor(abc.ABC):
    """Runs missions as `concurrent.futures` runs calls; close it after use.

    A future that is cancelled ends its mission at once. Each mission has ``timeout_s``; one that takes longer is ended and fails with
    ``timeout``, whatever it left.
    """

    def __init__(self, timeout_s: float) -> None:
        if not 0 < timeout_s <= MAX_TIMEOUT_S:
            raise UserError(
                f"the limit of a mission is {timeout_s:g} s; it must be positive, at most {MAX_TIMEOUT_S:g}"
            )
        self._timeout_s = timeout_s

    @property
    @abc.abstractmethod
    def capacity(self) -> int:
        """Missions at a time; it may change."""

    def begin(self) -> None:  # noqa: B027  most have nothing to do
        """Get ready while the caller does other things; otherwise the first mission waits for it."""

    @abc.abstractmethod
    def submit(self, job: MissionJob) -> Future[Trial]:
        """Start ``job`` and return at once; the future has the trial, also of a mission that failed."""

    @abc.abstractmethod
    def close(self) -> None:
        """End what runs and free all resources."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def settle(future: Future[Trial], trial: Callable[[], Trial]) -> None:
    """Give a future what ``trial`` returns or raises, unless it was cancelled meanwhile."""
    with contextlib.suppress(InvalidStateError):
        try:
            ended = trial()
        except BaseException as error:
            future.set_exception(error)
        else:
            future.set_result(ended)


class MissionPool(Executor):
    """Missions in processes of this machine; the first pool's ``fidelity`` says what is loaded for all of them."""

    def __init__(self, workers: int = 1, timeout_s: float = 3600.0, fidelity: str = DEFAULT_FIDELITY) -> None:
        if not 1 <= workers <= MAX_WORKERS:
            raise UserError(f"workers is {workers}; it must be 1 to {MAX_WORKERS}")
        super().__init__(timeout_s)
        self._workers, self._fidelity = workers, fidelity
        self._idle: list[_Worker] = []
        self._busy: set[_Worker] = set()

    @property
    def capacity(self) -> int:
        return self._workers

    def begin(self) -> None:
        with _processes:
            _start_server(self._fidelity)

    def submit(self, job: MissionJob) -> Future[Trial]:
        remove_earlier_result(job)
        future: Future[Trial] = Future()
        # A thread each, which nobody waits for at the end of the program: it waits for one mission.
        trial = functools.partial(self._trial, job, job.to_dict(), future)
        threading.Thread(target=settle, args=(future, trial), daemon=True).start()
        return future

    def close(self) -> None:
        for worker in (*self._busy, *self._idle):
            worker.kill()

    def _trial(self, job: MissionJob, order: dict[str, Any], future: Future[Trial]) -> Trial:
        try:
            worker = self._worker()
        except (OSError, EOFError) as error:  # no process or file more; the fork server ended
            return job.failed("not_started", f"no process could be started ({error or type(error).__name__})")
        self._busy.add(worker)
        future.add_done_callback(lambda done: worker.kill() if done.cancelled() else None)
        status, wall_s = worker.run(order, self._timeout_s)
        self._busy.discard(worker)
        trial = load_trial(job, wall_s) if wall_s <= self._timeout_s else None
        code = None
        if status == 0 and trial is not None and worker.missions < _MISSIONS_OF_A_PROCESS:
            self._idle.append(worker)
        else:
            code = worker.end()
        if trial is None:
            reason, message = self._why(wall_s, status, code)
            message = f"{message}; see {job.directory / WORKER_LOG}"
            trial = job.failed(reason, message, wall_s)
            if not future.cancelled():
                with contextlib.suppress(OSError):  # so that the directory tells its own story
                    record_failure(order, reason, message)
        return trial

    def _worker(self) -> _Worker:
        try:
            return self._idle.pop()
        except IndexError:
            return _Worker(self._fidelity)

    def _why(self, wall_s: float, status: int | None, code: int | None) -> tuple[str, str]:
        """Reason and message of a mission without a result: its ``status``, and the exit ``code`` of its process."""
        if wall_s > self._timeout_s:
            return "timeout", f"took longer than {self._timeout_s:g} s, the limit of a mission (--timeout-s)"
        if status == _NOT_WRITABLE:
            return "output_not_writable", "could not write to its directory, is the disk full?"
        if status is not None:
            return "no_result", "it left no result of this mission"
        if code == _SERVER_LOST:
            return "server_lost", "the process that starts missions was ended"
        if code is not None and code < 0:
            names = {number.value: number.name for number in signal.Signals}
            by = names.get(-code, f"signal {-code}")
            hint = ": memory ran out, or somebody ended it" if -code == signal.SIGKILL else ""
            return f"worker_died: {by}", f"its process was ended by {by}{hint}"
        return f"worker_died: exit {code}", "its process ended without a result"


class _Worker:
    """A process that runs missions, seen from the coordinator; ``OSError`` or ``EOFError`` where none can be started."""

    def __init__(self, fidelity: str) -> None:
        self.missions = 0
        self._connection, theirs = _context.Pipe()
        self._process = _context.Process(target=_work, args=(theirs,))
        with theirs, _processes, _no_main_module():
            _start_server(fidelity)
            self._process.start()

    def run(self, order: dict[str, Any], timeout_s: float) -> tuple[int | None, float]:
        """Run a mission; the status of `run_job`, None where there is no answer, and how long it took."""
        self.missions += 1
        began = time.monotonic()
        with contextlib.suppress(OSError, EOFError):
            self._connection.send((order, dict(os.environ), timeout_s))
            wait([self._connection, self._process.sentinel], timeout_s + _DUMP_S)
            if self._connection.poll():
                answer: tuple[int, float] = self._connection.recv()
                return answer  # by the worker's clock: this process may have been stopped meanwhile
        return None, time.monotonic() - began

    def kill(self) -> None:
        """Kill it, with all that it has started."""
        assert self._process.pid, "it has been started"
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.kill()  # where it leads no group yet

    def end(self) -> int | None:
        """Kill it, and return its exit code: its own where it had ended before."""
        self.kill()
        with _processes:
            self._process.join(_END_S)
            code = self._process.exitcode
        self._connection.close()
        return code


def _start_server(fidelity: str) -> None:
    """Start the process that all others are forked from, where there is none; it loads what missions of ``fidelity`` import."""
    before = dict(os.environ)
    # A library that starts threads cannot be forked; what lies in the current directory is no library; Ctrl-C is the coordinator's.
    path = os.pathsep.join(place for place in sys.path if place)
    changed = {**ONE_THREAD, "PYTHONSAFEPATH": "1", "PYTHONPATH": path}
    resource_tracker.ensure_running()  # it unblocks what is blocked next
    blocked = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        os.environ.update(changed)
        _context.set_forkserver_preload([__name__, *modules_of(fidelity)])
        forkserver.ensure_running()
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, blocked)
        for name in changed:
            os.environ.pop(name)
        os.environ.update(before)


@contextlib.contextmanager
def _no_main_module() -> Iterator[None]:
    """Hide the program's main module, which a new process would import: a script needs no ``if __name__ == "__main__"``."""
    main = sys.modules["__main__"]
    sys.modules["__main__"] = types.ModuleType("__main__")
    try:
        yield
    finally:
        sys.modules["__main__"] = main


def _work(orders: Connection) -> None:
    """What a worker does until its coordinator ends."""
    os.setsid()  # with what missions start it is one group, which Ctrl-C in the terminal does not reach
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    threading.Thread(target=_end_with_coordinator, daemon=True).start()
    with contextlib.suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text(_MEMORY_SCORE)
    with contextlib.suppress(EOFError):
        while True:
            order, environment, timeout_s = orders.recv()
            os.environ.update({**environment, **ONE_THREAD})
            began = time.monotonic()
            orders.send((_run_logged(order, timeout_s), time.monotonic() - began))


def _end_with_coordinator() -> None:
    coordinator = multiprocessing.parent_process()
    assert coordinator is not None
    coordinator.join()
    os.killpg(0, signal.SIGKILL)


def _run_logged(order: dict[str, Any], timeout_s: float) -> int:
    """`run_job`, and what it prints goes into the mission's log; so does where it is when the time is over, or where it crashes."""
    directory = Path(order["directory"])
    try:
        directory.mkdir(parents=True, exist_ok=True)
        with (directory / WORKER_LOG).open("ab") as log:
            os.dup2(log.fileno(), 1)
            os.dup2(log.fileno(), 2)
    except OSError:
        return _NOT_WRITABLE
    faulthandler.enable()
    # Should the coordinator not end it: compiled code that never returns hears of nothing else.
    faulthandler.dump_traceback_later(timeout_s, exit=True)
    try:
        return run_job(order)
    finally:
        faulthandler.cancel_dump_traceback_later()
        with contextlib.suppress(OSError):
            sys.stdout.flush()
            sys.stderr.flush()


def run_job(order: dict[str, Any]) -> int:
    """Run one mission in this process and leave ``mission.json`` in its directory, also of one that failed; 0, or why it did not."""
    directory = Path(order["directory"])
    try:
        directory.mkdir(parents=True, exist_ok=True)
        plugins.forget_used()
        job = MissionJob.from_dict(order)
        result = kind_on(job.rock, job.fidelity)(
            job.config, job.rock, job.replicate, directory, keep=job.keep
        )
        if not (directory / RESULT).exists():
            write_atomic(directory / RESULT, result.to_json())
        return 0
    except (Exception, SystemExit) as error:
        failed = error
    try:
        record_failure(order, *_reason(failed))
    except OSError:
        return _NOT_WRITABLE
    with contextlib.suppress(OSError):  # the log may lie on the same full disk
        traceback.print_exception(failed)
    return _FAILED


def _reason(error: BaseException) -> tuple[str, str]:
    if isinstance(error, UserError):
        return "user_error", str(error)
    if isinstance(error, MissionFailure):
        return error.reason, error.message
    if isinstance(error, MemoryError):
        return "out_of_memory", "the mission ran out of memory"
    if isinstance(error, OSError):
        code = errno.errorcode.get(error.errno or 0, "unknown")
        kind = "machine_error" if error.errno in _MACHINE_ERRORS else "os_error"
        return "disk_full" if error.errno in _FULL else f"{kind}: {code}", str(error)
    last = traceback.extract_tb(error.__traceback__)[-1]
    where = f"{Path(last.filename).name}, line {last.lineno}"
    return "mission_error", f"{type(error).__name__}: {error} ({where})"


def local_pool(fidelity: str, workers: int | None, timeout_s: float) -> MissionPool:
    """Return processes for missions, one per core unless told otherwise."""
    count = len(os.sched_getaffinity(0)) if workers is None else workers
    return MissionPool(count, timeout_s, fidelity)
