"""The loop that runs many missions: a queue hands out as many jobs at a time as the executor has free workers."""

from __future__ import annotations

import collections
import contextlib
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Future
from queue import Empty, SimpleQueue
from typing import Protocol

from nbv.errors import UserError
from tuner.missions.job import MissionJob, Trial, should_retry
from tuner.missions.long_runs import Stop
from tuner.missions.pool import Executor

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
        self.waiting = collections.deque(job for job in jobs if not job.has_finished())
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
