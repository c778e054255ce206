"""The one loop that flies many missions: a source hands out jobs, as many at a time as the executor has room for."""

from __future__ import annotations

import collections
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Protocol

from nbv.errors import UserError
from tuner.missions.executors import Executor
from tuner.missions.job import MissionJob, Trial
from tuner.missions.long_runs import Stop

_POLL_S = 0.5
_SHORT_POLL_S = 0.05  # while a job is being thought of and there is room for it


class Source(Protocol):
    """What jobs come from, and how their missions ended goes to."""

    @property
    def thinking(self) -> bool:
        """Whether there may be more jobs although there are none at this moment."""
        ...

    @property
    def given_up(self) -> bool:
        """Whether missions in flight are not worth waiting for."""
        ...

    def take(self, free: int) -> Sequence[MissionJob]:
        """Return jobs to fly now, at most ``free``; none: not now, or no more."""
        ...

    def launched(self, job: MissionJob) -> None:
        """Take note that a job flies."""
        ...

    def ended(self, trials: Sequence[Trial]) -> None:
        """Take note of how missions ended; none where none has within half a second."""
        ...


class JobList:
    """A fixed list of jobs, flown in order; those that have finished already are not flown again.

    ``on_launch`` and ``on_end`` are called with each.
    """

    thinking = given_up = False

    def __init__(
        self,
        jobs: Iterable[MissionJob],
        on_launch: Callable[[MissionJob], None] = lambda job: None,
        on_end: Callable[[Trial], None] = lambda trial: None,
    ) -> None:
        self.waiting = collections.deque(job for job in jobs if not job.has_finished())
        self.open = len(self.waiting)  # not flown to an end that counts
        self.launched, self._on_end = on_launch, on_end

    def take(self, free: int) -> list[MissionJob]:
        """The next ones."""
        return [self.waiting.popleft() for _ in range(min(free, len(self.waiting)))]

    def ended(self, trials: Sequence[Trial]) -> None:
        """Count them."""
        for trial in trials:
            self.open -= not trial.infrastructure_failure
            self._on_end(trial)


@dataclass
class _Flight:
    job: MissionJob
    attempt: int = 1
    excused: bool = False  # an earlier attempt ended by what may have been the machine


def fly(source: Source, executor: Executor, stop: Stop) -> None:
    """Fly what ``source`` hands out until there is no more, it gives up, or somebody asks for a stop.

    What the machine ends (somebody kills or stops a process, no process can be started, the disk is full) says nothing
    about the mission: it is flown again, and comes back as an infrastructure failure only after `MAX_ATTEMPTS`. The executor is
    left open; missions still in flight at the end are killed.

    Raises
    ------
    UserError
        A mission met a user's mistake, which every other one would meet too.
    """
    flying: dict[str, _Flight] = {}
    try:
        while not stop.is_set() and not source.given_up:
            while (free := executor.capacity - len(flying)) > 0 and (jobs := source.take(free)):
                for job in jobs:
                    executor.submit(job)
                    flying[job.id] = _Flight(job)
                    source.launched(job)
            if not flying:
                if not source.thinking:
                    return
                stop.wait(_SHORT_POLL_S)
                continue
            ended = []
            for trial in executor.wait_any(_SHORT_POLL_S if free > 0 and source.thinking else _POLL_S):
                flight = flying.pop(trial.job_id)
                if trial.reason == "user_error":
                    raise UserError(trial.message)
                if trial.should_retry(flight.attempt, excused=flight.excused):
                    executor.submit(flight.job)
                    excused = flight.excused or trial.possibly_machine_fault
                    flying[trial.job_id] = _Flight(flight.job, flight.attempt + 1, excused)
                else:
                    ended.append(trial)
            source.ended(ended)
    finally:
        executor.cancel_all()
