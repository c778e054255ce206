"""An executor for tests: missions in this very process."""

import collections
import time

from tuner.missions.executors import Executor
from tuner.missions.job import MissionJob, Trial, load_trial, remove_earlier_result
from tuner.missions.run_job import run_job


class InProcessExecutor(Executor):
    """One mission at a time in this process, without any protection: for debugging and tests."""

    capacity = 1

    def __init__(self) -> None:
        self._queue: collections.deque[MissionJob] = collections.deque()

    def submit(self, job: MissionJob) -> None:
        """Queue ``job``."""
        self._queue.append(job)

    def wait_any(self, timeout_s: float) -> list[Trial]:
        """Run the oldest job, however long it takes."""
        if not self._queue:
            return []
        job = self._queue.popleft()
        remove_earlier_result(job)
        started = time.monotonic()
        run_job(job.to_dict())
        trial = load_trial(job, time.monotonic() - started)
        return [trial or job.failed("no_result", f"nothing was written to {job.directory}")]

    def cancel_all(self) -> None:
        """Forget what has not started."""
        self._queue.clear()
