"""The loop that runs many missions: a queue hands out as many jobs at a time as the executor has free workers."""

from __future__ import annotations

import collections
import contextlib
import fcntl
import signal
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Protocol, TypeVar

from nbv.errors import UserError
from tuner.missions.job import MissionJob, Trial, load_trial, should_retry
from tuner.missions.pool import Executor

# What every long run needs: one owner per directory, and an orderly stop.


LOCK_FILE = "run.lock"
T = TypeVar("T")


@contextlib.contextmanager
def exclusive(directory: Path) -> Iterator[None]:
    """Hold the directory's lock; the kernel frees it when the process dies, however it dies.

    Raises `UserError`: another process holds it, or the directory cannot be written.
    """
    try:
        lock = (directory / LOCK_FILE).open("ab")
    except OSError as error:
        raise UserError(f"cannot write to {directory}: {error.strerror}; make it writable") from error
    with lock as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise UserError(f"{directory} is in use by another process; wait for it or stop it") from error
        yield


class Stop(threading.Event):
    """Whether somebody asked for a stop."""

    def __init__(self) -> None:
        super().__init__()
        self.breaks = False  # whether a signal interrupts the running computation at once

    def computed(self, compute: Callable[[], T]) -> T | None:
        """Return what ``compute``, which writes nothing, returns; a stop ends it at once, and None is returned."""
        try:
            self.breaks = True
            return None if self.is_set() else compute()
        except KeyboardInterrupt:
            if not self.is_set():
                raise
            return None
        finally:
            self.breaks = False


@contextlib.contextmanager
def stop_signals() -> Iterator[Stop]:
    """Turn the first SIGINT or SIGTERM into a flag to be looked at between writes; a second one interrupts.

    Outside the main thread, where Python allows no handlers, the flag is never set.
    """
    stop = Stop()
    if threading.current_thread() is not threading.main_thread():
        yield stop
        return

    def ask_to_stop(number: int, frame: object) -> None:
        again = stop.is_set()
        stop.set()
        if again or stop.breaks:
            raise KeyboardInterrupt

    before = {number: signal.signal(number, ask_to_stop) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextlib.contextmanager
def long_run(directory: Path) -> Iterator[Stop]:
    """Hold the directory and turn signals into a stop, for what writes there all the time.

    Raises `UserError`: as `exclusive`; or something could not be written.
    """
    try:
        with exclusive(directory), stop_signals() as stop:
            yield stop
    except OSError as error:
        raise UserError(
            f"cannot write to {directory}: {error.strerror or error}; make room, then resume"
        ) from error


_POLL_S = 0.5


class JobQueue(Protocol):
    """Hands out jobs and is told how their missions ended."""

    @property
    def cancelled(self) -> bool:
        """Whether missions in flight are not worth waiting for."""

    def next_jobs(self, free: int) -> Sequence[MissionJob]:
        """Return jobs to run now, at most ``free``; none: not now, or no more."""

    def launched(self, job: MissionJob) -> None:
        """Is called when a job has been submitted."""

    def ended(self, trials: Sequence[Trial]) -> None:
        """Is called with the trials that have ended; with none where none has ended within half a second."""


class JobList:
    """A fixed list of jobs, run in order; those that have finished already are not run again."""

    cancelled = False

    def __init__(
        self,
        jobs: Iterable[MissionJob],
        on_launch: Callable[[MissionJob], None] = lambda job: None,
        on_end: Callable[[Trial], None] = lambda trial: None,
    ) -> None:
        self.waiting = collections.deque(
            job for job in jobs if (trial := load_trial(job)) is None or not trial.is_final
        )
        self.open = len(self.waiting)  # not run to an end that counts
        self.launched, self._on_end = on_launch, on_end

    def next_jobs(self, free: int) -> list[MissionJob]:
        return [self.waiting.popleft() for _ in range(min(free, len(self.waiting)))]

    def ended(self, trials: Sequence[Trial]) -> None:
        for trial in trials:
            self.open -= not trial.infrastructure_failure
            self._on_end(trial)


def run_jobs(source: JobQueue, executor: Executor, stop: Stop) -> None:
    """Run what ``source`` hands out until there is no more, it gives up, or somebody asks for a stop.

    What the machine ends (no process can be started, the disk is full, a worker is lost) says nothing about the mission: it is run
    again, and comes back as an infrastructure failure only after `MAX_ATTEMPTS`; what may be the machine's doing is run again once
    (`should_retry`). The executor is left open; missions still in flight at the end are ended.

    Raises `UserError`: a mission met a user's mistake, which every other one would meet too.
    """
    running: dict[Future[Trial], tuple[MissionJob, list[Trial]]] = {}  # with the attempts that have ended
    done: SimpleQueue[Future[Trial]] = SimpleQueue()

    def submit(job: MissionJob, attempts: list[Trial]) -> None:
        future = executor.submit(job)
        running[future] = job, attempts
        future.add_done_callback(done.put)

    try:
        while not stop.is_set() and not source.cancelled:
            free = executor.capacity - len(running)
            while free > 0 and (jobs := source.next_jobs(free)):
                for job in jobs:
                    submit(job, [])
                    source.launched(job)
                free = executor.capacity - len(running)
            if not running:
                return
            arrived: list[Future[Trial]] = []
            with contextlib.suppress(Empty):
                arrived.append(done.get(timeout=_POLL_S))
                while True:
                    arrived.append(done.get_nowait())
            ended = []
            for future in arrived:
                job, earlier = running.pop(future)
                attempts = [*earlier, future.result()]
                if attempts[-1].reason == "user_error":
                    raise UserError(attempts[-1].record.message)
                if should_retry(attempts):
                    submit(job, attempts)
                else:
                    ended.append(attempts[-1])
            source.ended(ended)
    finally:
        for future in running:
            future.cancel()
