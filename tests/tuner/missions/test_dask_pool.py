"""Missions on a real Dask cluster, with plug-ins: none is lost, what hangs or is not there fails clearly."""

import collections
import gc
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest
from fake_campaigns import settings
from test_pool import job, run_jobs

from nbv import plugins
from nbv.config import preset
from nbv.errors import UserError
from nbv.rocks.catalogue import read_rock, write_rock
from nbv.rocks.rock import make_rock
from tuner.campaign.begin import begin_campaign
from tuner.campaign.campaign import Campaign, CampaignEvent
from tuner.campaign.session import run_campaign
from tuner.missions import dask_pool
from tuner.missions.dask_pool import DaskPool
from tuner.missions.job import MissionJob

pytest.importorskip("distributed", reason="pip install 'gatetune[cluster]'")


MISSIONS = 12
COORDINATOR = """
import os, signal, sys
import fake_missions
from pathlib import Path
from tuner.campaign.campaign import Campaign
from tuner.campaign.session import run_campaign
from tuner.missions.dask_pool import DaskPool
directory, scheduler, worker = sys.argv[1:]
def accidents(event):
    if event.kind == "finished" and event.finished == 3:
        os.kill(int(worker), signal.SIGKILL)
    if event.kind == "finished" and event.finished == 6:
        os.kill(os.getpid(), signal.SIGKILL)
run_campaign(Campaign.open(Path(directory)), DaskPool(scheduler, 60.0), accidents)
"""


class Cluster:
    """A scheduler and workers, each a process, as `dask scheduler` and `dask worker` start them."""

    def __init__(self, folder: Path, workers: int, *, nanny: bool = False) -> None:
        self._file = folder / f"scheduler-{time.monotonic_ns()}.json"
        self.flights = folder / "flights.txt"
        options = ["--host", "127.0.0.1", "--port", "0", "--no-dashboard"]
        self.scheduler = self._start("scheduler", *options)
        deadline = time.monotonic() + 30
        while not (self._file.exists() and self._file.stat().st_size) and time.monotonic() < deadline:
            time.sleep(0.02)
        local = ["--nthreads", "1", "--no-dashboard", "--local-directory", str(folder)]
        local += [] if nanny else ["--no-nanny"]
        self.workers = [self._start("worker", *local) for _ in range(workers)]

    def _start(self, what: str, *options: str) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", f"distributed.cli.dask_{what}", "--scheduler-file", str(self._file)]
        own = {"FAKE_FLIGHTS": str(self.flights), "GATETUNE_HOME": str(self._file.parent / "worker-home")}
        environment = {**os.environ, **own, "PYTHONPATH": os.pathsep.join(sys.path)}
        return subprocess.Popen([*command, *options], env=environment, stderr=subprocess.DEVNULL)

    @property
    def address(self) -> str:
        return str(json.loads(self._file.read_text())["address"])

    @property
    def file(self) -> str:
        return str(self._file)

    def __enter__(self) -> "Cluster":
        return self

    def __exit__(self, *_: object) -> None:
        for process in (*self.workers, self.scheduler):
            process.kill()
            process.wait()


def wait_for(happened: Callable[[], Any], within_s: float = 60.0) -> Any:
    deadline = time.monotonic() + within_s
    while not (found := happened()):
        assert time.monotonic() < deadline
        time.sleep(0.02)
    return found


def tasks(dask_scheduler: Any) -> list[str]:
    return list(dask_scheduler.tasks)


def test_no_mission_is_lost_or_entered_twice(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(dask_pool, "_RECONNECT_S", 0.5)
    directory = tmp_path / "run"
    begin_campaign(directory, settings(sampler="sobol", budget=MISSIONS, rocks=("slow", "slow-2")))
    with Cluster(tmp_path, 2) as cluster:
        # Its worker, then the coordinator itself are killed.
        named = [str(directory), cluster.address, str(cluster.workers[0].pid)]
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
        ended = subprocess.run([sys.executable, "-c", COORDINATOR, *named], env=environment, timeout=60)
        assert ended.returncode == -signal.SIGKILL
        assert sum(t.state == "complete" for t in Campaign.open(directory, read_only=True).trials()) == 6

        def end_scheduler(event: CampaignEvent) -> None:
            if event.kind == "finished" and event.finished == 9:
                cluster.scheduler.kill()

        campaign = Campaign.open(directory)
        with (
            DaskPool(cluster.file, 60.0) as executor,
            pytest.raises(UserError, match="scheduler is gone"),
        ):
            run_campaign(campaign, executor, end_scheduler)
    with Cluster(tmp_path, 1) as cluster, DaskPool(cluster.file, 60.0) as executor:
        assert run_campaign(campaign, executor).stopped == "budget"
    trials = campaign.trials()
    assert [t.state for t in trials] == ["complete"] * MISSIONS
    # The missions' own record: all ran, and again only what was in the air at one of the three ends.
    evaluated = collections.Counter(cluster.flights.read_text().splitlines())
    assert len(evaluated) == MISSIONS and sum(evaluated.values()) <= MISSIONS + 3 * 2
    for trial in trials:
        assert (trial.record.directory / "run.txt").read_text() == "run\n"


def test_own_rocks_reach_workers_and_other_versions_are_refused(tmp_path, monkeypatch):
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])
    sides = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    own = make_rock("own", corners, sides, np.full((4, 3), 0.5), split="train", difficulty="mine")
    write_rock(own, tmp_path / "own.npz")
    with Cluster(tmp_path, 1) as cluster, DaskPool(cluster.file, 60.0) as executor:
        gc.disable()
        ended = run_jobs(executor, [job(tmp_path, str(tmp_path / "own.npz"), fidelity="fake-on-rocks")])
        assert ended["0000"].record.status == "ok"
        # A scheduler runs anew what it believes wanted, should a worker be lost.
        look = executor._client.run_on_scheduler
        wait_for(lambda: not [key for key in look(tasks) if not key.startswith("rock-")], within_s=5.0)
        gc.enable()
        there = tmp_path / "worker-home/rocks/received" / f"{own.sha256}.npz"
        assert json.loads((tmp_path / "0000" / "mission.json").read_text())["rock"] == str(there)
        assert read_rock(there).sha256 == own.sha256
        monkeypatch.setattr(dask_pool, "versions", lambda: {"python": "2.7.18"})
        said = f"python is {sys.version.split()[0]} there and 2.7.18 here"
        with pytest.raises(UserError, match=said):
            run_jobs(executor, [job(tmp_path, "boulder", 3)])


@pytest.mark.parametrize("scheduler", ["boulder", "tcp://[::1", "tcp://127.0.0.1:1", "tls://127.0.0.1:1"])
def test_a_scheduler_that_does_not_answer_is_refused(scheduler: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(dask_pool, "_CONNECT_S", 0.2)
    with pytest.raises(UserError, match=r"answers at|no such file"):
        DaskPool(scheduler, 60.0)


def test_a_mission_that_crashes_or_hangs_fails_alone_on_a_worker_with_a_nanny(tmp_path: Path) -> None:
    with Cluster(tmp_path, 1, nanny=True) as cluster, DaskPool(cluster.address, 2.0) as executor:
        ended = run_jobs(
            executor, [job(tmp_path, rock, n) for n, rock in enumerate(["abort", "hang", "late", "a"])]
        )
    reasons = [ended[f"000{n}"].reason for n in range(4)]
    assert reasons == ["worker_died: SIGABRT", "timeout", "timeout", ""]


def test_a_mission_that_nobody_waits_for_ends_on_its_worker(tmp_path: Path) -> None:
    with Cluster(tmp_path, 1) as cluster, DaskPool(cluster.address, 60.0) as executor:
        future = executor.submit(job(tmp_path, "start"))
        (started,) = wait_for(lambda: list(tmp_path.rglob("mission-*/started.txt")))
        pid = int(wait_for(started.read_text))
        future.cancel()
        wait_for(lambda: not psutil.pid_exists(pid), within_s=5.0)


REGISTERS = """
from nbv.config import Weights
from nbv.plugins import register
from nbv.scorers import Scorer

def high(terms, pool, config):
    return pool.positions_m[:, 2] / 8.0

register("scorers", "high", Scorer("high", high, weights=lambda config: Weights()))
"""


@pytest.mark.slow
def test_registered_plug_ins_run_on_dask(tmp_path, monkeypatch):
    file = tmp_path / "registers_scorers.py"
    file.write_text(REGISTERS)
    monkeypatch.setattr(plugins, "_registered", {})
    monkeypatch.setattr(sys, "path", [*sys.path])
    config = preset("campaign").with_values({"photographs": 26})
    with Cluster(tmp_path, 1) as cluster, DaskPool(cluster.address, 60.0) as executor:
        plugins.use(str(file))  # workers find the file by what they are told
        planned = config.with_values({"gate.kind": "high"})
        mission = MissionJob("one", planned, "slab", 0, tmp_path / "one", fidelity="geometric")
        ended = run_jobs(executor, [mission])["one"]
    assert ended.record.status == "ok", ended.record.message
    assert "scorers/high" in (tmp_path / "one" / "mission.json").read_text()
    sys.modules.pop("registers_scorers")
