import collections
import gc
import io
import json
import os
import signal
import subprocess
import sys
import time
import zipfile
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("distributed", reason="pip install 'gatetune[cluster]'")

from collections.abc import Callable
from typing import Any

from fake_campaigns import settings
from test_executors import job, run_jobs

from nbv.errors import UserError
from nbv.rocks.catalogue import read_rock, write_rock
from nbv.rocks.rock import make_rock
from tuner.campaign.begin import begin_campaign
from tuner.campaign.campaign import Campaign
from tuner.campaign.events import CampaignEvent
from tuner.campaign.session import run_campaign
from tuner.missions.cluster import worker
from tuner.missions.cluster.connect import dask_executor

MISSIONS = 12
COORDINATOR = """
import os, signal, sys
import fake_missions
from pathlib import Path
from tuner.campaign.campaign import Campaign
from tuner.campaign.session import run_campaign
from tuner.missions.cluster.connect import dask_executor
directory, scheduler, worker = sys.argv[1:]
def accidents(event):
    if event.kind == "finished" and event.finished == 3:
        os.kill(int(worker), signal.SIGKILL)
    if event.kind == "finished" and event.finished == 6:
        os.kill(os.getpid(), signal.SIGKILL)
run_campaign(Campaign.open(Path(directory)), dask_executor("dask", scheduler, 1, 60.0), accidents)
"""


class Cluster:
    """A scheduler and workers, each a process."""

    def __init__(self, folder: Path, workers: int, host: str = "127.0.0.1") -> None:
        self._file = folder / f"scheduler-{time.monotonic_ns()}.json"
        self.flights = folder / "flights.txt"
        options = ["--host", host, "--port", "0", "--no-dashboard"]
        self.scheduler = self._start("scheduler", *options)
        deadline = time.monotonic() + 30
        while not (self._file.exists() and self._file.stat().st_size) and time.monotonic() < deadline:
            time.sleep(0.02)
        local = ["--nthreads", "1", "--no-nanny", "--no-dashboard", "--local-directory", str(folder)]
        self.workers = [self._start("worker", *local) for _ in range(workers)]

    def _start(self, what: str, *options: str) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", f"distributed.cli.dask_{what}", "--scheduler-file", str(self._file)]
        own = {"FAKE_FLIGHTS": str(self.flights), "GATETUNE_HOME": str(self._file.parent / "worker-home")}
        environment = {**os.environ, **own, "PYTHONPATH": os.pathsep.join(sys.path)}
        return subprocess.Popen([*command, *options], env=environment, stderr=subprocess.DEVNULL)

    @property
    def address(self) -> str:
        return str(json.loads(self._file.read_text())["address"])

    def __enter__(self) -> "Cluster":
        return self

    def __exit__(self, *_: object) -> None:
        for process in (*self.workers, self.scheduler):
            process.kill()
            process.wait()


def wait_for(happened: Callable[[], Any], within_s: float = 20.0) -> Any:
    deadline = time.monotonic() + within_s
    while not (found := happened()):
        assert time.monotonic() < deadline
        time.sleep(0.02)
    return found


def tasks(dask_scheduler: Any) -> list[str]:
    return list(dask_scheduler.tasks)


def test_links_that_a_mission_left_do_not_come_back(tmp_path: Path) -> None:
    (tmp_path / "there").mkdir()
    (tmp_path / "there/mission.json").write_text("{}")
    (tmp_path / "there/link").symlink_to("/etc")
    os.mkfifo(tmp_path / "there/pipe")
    worker.unpack(worker.pack(tmp_path / "there"), tmp_path / "here")
    assert [path.name for path in (tmp_path / "here").iterdir()] == ["mission.json"]


def test_no_file_of_a_mission_lands_outside_its_directory(tmp_path: Path) -> None:
    with zipfile.ZipFile(buffer := io.BytesIO(), "w") as archive:
        for name in ("../beside.txt", "/absolute.txt", "a/../../up.txt"):
            archive.writestr(name, "")
    worker.unpack(buffer.getvalue(), tmp_path / "here")
    assert [path.name for path in tmp_path.iterdir()] == ["here"]
    assert len(list((tmp_path / "here").rglob("*.txt"))) == 3


def test_no_mission_is_lost_or_entered_twice(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tuner.missions.cluster.executor._RECONNECT_S", 0.5)
    monkeypatch.setattr("tuner.missions.cluster.connect._CONNECT_S", 15.0)
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
            dask_executor("dask", cluster.address, 1, 60.0) as executor,
            pytest.raises(UserError, match="scheduler is gone"),
        ):
            run_campaign(campaign, executor, end_scheduler)
    with Cluster(tmp_path, 1) as cluster, dask_executor("dask", cluster.address, 1, 60.0) as executor:
        assert run_campaign(campaign, executor).stopped == "budget"
    trials = campaign.trials()
    assert [t.state for t in trials] == ["complete"] * MISSIONS
    # The missions' own record: all ran, and again only what was in the air at one of the three ends.
    evaluated = collections.Counter(cluster.flights.read_text().splitlines())
    assert len(evaluated) == MISSIONS and sum(evaluated.values()) <= MISSIONS + 3 * 2
    for trial in trials:
        assert (trial.record.directory / "run.txt").read_text() == "run\n"


def test_own_rocks_reach_workers_and_other_versions_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])
    sides = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    own = make_rock("own", corners, sides, np.full((4, 3), 0.5), split="train", difficulty="mine")
    write_rock(own, tmp_path / "own.npz")
    with Cluster(tmp_path, 1) as cluster:
        with dask_executor("dask", cluster.address, 1, 60.0) as executor:
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
            monkeypatch.setattr(worker, "versions", lambda: {"python": "2.7.18"})
            said = f"python is {sys.version.split()[0]} on the worker and 2.7.18 here"
            with pytest.raises(UserError, match=said):
                run_jobs(executor, [job(tmp_path, "boulder", 3)])
        with pytest.raises(UserError, match=r"on the scheduler and 2\.7\.18 here"):
            dask_executor("dask", cluster.address, 1, 60.0)


@pytest.mark.parametrize(
    ("address", "said"),
    [
        ("tcp://10.0.0.1:8786", "--unencrypted"),
        ("boulder", "not an address"),
        ("tcp://[::1", "not an address"),
        ("tcp://127.0.0.1:1", "answers"),
    ],
)
def test_addresses_that_are_refused(address: str, said: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tuner.missions.cluster.connect._CONNECT_S", 0.2)
    with pytest.raises(UserError, match=said):
        dask_executor("dask", address, 1, 60.0)


def test_a_scheduler_that_others_reach_is_refused(tmp_path: Path) -> None:
    with Cluster(tmp_path, 0, host="0.0.0.0") as cluster:
        reached = f"tcp://127.0.0.1:{cluster.address.rpartition(':')[2]}"
        with pytest.raises(UserError, match="without TLS; start it"):
            dask_executor("dask", reached, 1, 60.0)
        dask_executor("dask", reached, 1, 60.0, unencrypted=True).close()


def states(dask_scheduler: Any) -> list[tuple[str, list[str]]]:
    return [(task.state, [w.address for w in task.who_has or ()]) for task in dask_scheduler.tasks.values()]


def test_a_result_that_its_worker_loses_is_not_flown_anew(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with Cluster(tmp_path, 2) as cluster, dask_executor("dask", cluster.address, 1, 60.0) as executor:
        look = executor._client.run_on_scheduler
        # The coordinator has the result, and is cut off before the scheduler hears so.
        send = executor._client._send_to_scheduler
        monkeypatch.setattr(
            executor._client,
            "_send_to_scheduler",
            lambda message: None if message["op"] == "client-releases-keys" else send(message),
        )
        wait_for(lambda: executor.workers == 2)
        assert run_jobs(executor, [job(tmp_path)])["0000"].record.status == "ok"
        ((state, (keeps,)),) = look(states)
        assert state == "memory"
        os.kill(executor._client.run(os.getpid, workers=[keeps])[keeps], signal.SIGKILL)
        wait_for(lambda: [s for s in look(states) if s[0] == "memory" and s[1] != [keeps]])
        assert len(cluster.flights.read_text().splitlines()) == 1
