"""An executor for tests: missions in this very process."""

import time
from concurrent.futures import Future

from nbv.mission.run_directory import RESULT
from nbv.safe_files import remove
from tuner.missions.job import MissionJob, Trial, load_trial
from tuner.missions.pool import Executor, run_job


class InProcessExecutor(Executor):
    """One mission at a time in this process, without any protection: for debugging and tests."""

    capacity = 1

    def __init__(self) -> None:
        super().__init__(60.0)

    def submit(self, job: MissionJob) -> Future[Trial]:
        """Run it, however long it takes."""
        remove(job.directory / RESULT)
        started, future = time.monotonic(), Future()
        run_job(job.to_dict())
        trial = load_trial(job, time.monotonic() - started)
        future.set_result(trial or job.failed("no_result", f"nothing was written to {job.directory}"))
        return future

    def close(self) -> None:
        """Nothing runs."""
