"""The loop that runs many missions: a queue hands out as many jobs at a time as the executor has free workers."""

from __future__ import annotations

import collections
from collections.abc import Callable, Iterable, Sequence
from typing import Protocol

from nbv.errors import UserError
from tuner.missions.executors import Executor
from tuner.missions.job import LOST, MissionJob, Trial, blamed, should_retry
from tuner.missions.long_runs import Stop

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

    What the machine ends (somebody kills or stops a process, no process can be started, the disk is full) says nothing
    about the mission: it is run again, and comes back as an infrastructure failure only after `MAX_ATTEMPTS`; of one that another's
    code plans that is the planner's failure. Missions that were lost together are run again one at a time and nothing beside
    them, and the loss is not counted: one of them may have ended the others. The executor is left open; missions still in
    flight at the end are killed.

    Raises `UserError`: a mission met a user's mistake, which every other one would meet too.
    """
    running: dict[str, tuple[MissionJob, list[Trial]]] = {}  # with the attempts that have ended
    suspects: list[tuple[MissionJob, list[Trial]]] = []  # to be run again alone; the first may be running

    def submit(job: MissionJob, attempts: list[Trial]) -> None:
        executor.submit(job)
        running[job.id] = job, attempts

    try:
        while not stop.is_set() and not source.cancelled:
            if suspects and not running:
                submit(*suspects[0])
            free = 0 if suspects else executor.capacity - len(running)
            while free > 0 and (jobs := source.next_jobs(free)):
                for job in jobs:
                    submit(job, [])
                    source.launched(job)
                free = executor.capacity - len(running)
            if not running:
                return
            ended = []
            trials = executor.wait_any(_POLL_S)
            lost = [trial for trial in trials if trial.reason in LOST]
            for trial in trials:
                job, attempts = running.pop(trial.record.job_id)
                suspects = [suspect for suspect in suspects if suspect[0] is not job]
                if trial.reason == "user_error":
                    raise UserError(trial.record.message)
                together = trial in lost and len(lost) > 1
                counted = attempts if together else [*attempts, trial]
                if not together and not should_retry(counted):
                    ended.append(blamed(job, counted))
                elif trial in lost:
                    suspects.append((job, counted))
                else:
                    submit(job, counted)
            source.ended(ended)
    finally:
        executor.cancel_all()
