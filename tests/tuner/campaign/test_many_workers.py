"""Many workers are kept busy: proposals, ledger and bookkeeping of a campaign by the processor's time, missions by a clock that jumps."""

import queue
import time
from concurrent.futures import Future
from pathlib import Path

import pytest
from fake_campaigns import settings
from fake_missions import fake_mission

from tuner.campaign.begin import begin_campaign
from tuner.campaign.session import run_campaign
from tuner.missions.job import MissionJob, Trial, load_trial
from tuner.missions.pool import Executor
from tuner.problem.space_files import load_search_space

WORKERS, MISSION_S, BUDGET = 512, 20.0, 1536


class SimulatedWorkers(Executor):
    """Missions take no time to compute; each ends `MISSION_S` after its start on a clock of what the coordinator computes."""

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
        """Nothing runs."""


@pytest.mark.slow
def test_512_workers_are_busy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    campaign = begin_campaign(
        tmp_path / "run", settings(space=load_search_space("gate"), budget=BUDGET, replicates=8)
    )
    with SimulatedWorkers() as executor:

        class Ended(queue.SimpleQueue):
            def get(self, block: bool = True, timeout: float | None = None) -> Future[Trial]:
                if block:
                    executor.end_next()
                return super().get(block=False)

        monkeypatch.setattr("tuner.missions.run_jobs.SimpleQueue", Ended)
        run_campaign(campaign, executor)
    starts = executor.starts[:BUDGET]
    took_s = starts[-1] - starts[0]
    busy_s = sum(min(MISSION_S, starts[-1] - start) for start in starts)
    share = busy_s / (WORKERS * took_s)
    assert share >= 0.7, f"{100 * share:.0f} % busy over {took_s:.0f} s"
