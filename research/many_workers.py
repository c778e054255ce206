"""How busy a campaign keeps 512 workers whose missions take 20 s: ``python -m research.many_workers``.

The workers are simulated: a mission takes no time to compute and ends 20 s after its start on a clock of the coordinator's CPU time.
"""

from __future__ import annotations

import queue
import sys
import tempfile
import time
from concurrent.futures import Future
from pathlib import Path
from typing import Any
from unittest.mock import patch

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests" / "support"))

from fake_campaigns import settings
from fake_missions import fake_mission

from tuner.campaign.begin import begin_campaign
from tuner.campaign.session import run_campaign
from tuner.missions.job import MissionJob, Trial, load_trial
from tuner.missions.pool import Executor
from tuner.problem.space_files import load_search_space

WORKERS, MISSION_S, BUDGET = 512, 20.0, 1536


class SimulatedWorkers(Executor):
    capacity = WORKERS

    def __init__(self) -> None:
        super().__init__(60.0)
        self._jumped_s = self._missions_s = 0.0
        self._ends: dict[Future[Trial], tuple[float, MissionJob]] = {}
        self.starts: list[float] = []

    @property
    def now(self) -> float:
        return time.process_time() - self._missions_s + self._jumped_s

    def submit(self, job: MissionJob) -> Future[Trial]:
        future: Future[Trial] = Future()
        self.starts.append(self.now)
        began = time.process_time()
        job.directory.mkdir(parents=True)
        result = fake_mission(job.config, job.rock, job.replicate, job.directory)
        (job.directory / "mission.json").write_text(result.to_json())
        self._missions_s += time.process_time() - began
        self._ends[future] = self.starts[-1] + MISSION_S, job
        return future

    def end_next(self) -> None:
        """End what has ended by now, else what ends next: the clock jumps there."""
        first = min(end for end, _ in self._ends.values())
        self._jumped_s += max(0.0, first - self.now)
        for future in [future for future, (end, _) in self._ends.items() if end <= self.now]:
            _, job = self._ends.pop(future)
            future.set_result(load_trial(job, MISSION_S))

    def close(self) -> None:
        pass


def main() -> None:
    """Print the share of the workers' time in which they fly."""
    with tempfile.TemporaryDirectory() as folder, SimulatedWorkers() as executor:
        asked = settings(space=load_search_space("gate"), budget=BUDGET, replicates=8)
        campaign = begin_campaign(Path(folder) / "run", asked)

        class Ended(queue.SimpleQueue[Any]):
            def get(self, block: bool = True, timeout: float | None = None) -> Any:
                if block:
                    executor.end_next()
                return super().get(block=False)

        with patch("tuner.missions.run_jobs.SimpleQueue", Ended):
            run_campaign(campaign, executor)
        starts = executor.starts[:BUDGET]
    took_s = starts[-1] - starts[0]
    busy_s = sum(min(MISSION_S, starts[-1] - start) for start in starts)
    print(f"{WORKERS} workers: {100 * busy_s / (WORKERS * took_s):.0f} % busy over {took_s:.0f} s")


if __name__ == "__main__":
    main()
