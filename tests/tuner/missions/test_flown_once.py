"""What a scheduler would make anew, or a worker begin that was given up, is not flown."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("distributed", reason="pip install 'gatetune[cluster]'")

from test_cluster import Cluster
from test_executors import fly, job

from tuner.missions.cluster.connect import dask_executor
from tuner.missions.cluster.executor import DaskExecutor


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    cluster = Cluster(tmp_path_factory.mktemp("cluster"), 2)
    yield cluster
    cluster.close()


def on_scheduler(executor: DaskExecutor, look: Callable[..., Any]) -> Any:
    return executor._client.run_on_scheduler(look)


def wait_for(happened: Callable[[], Any]) -> Any:
    deadline = time.monotonic() + 20
    while not (found := happened()):
        assert time.monotonic() < deadline
        time.sleep(0.02)
    return found


def states(dask_scheduler: Any) -> list[tuple[str, list[str]]]:
    return [(task.state, [w.address for w in task.who_has or ()]) for task in dask_scheduler.tasks.values()]


def test_a_result_that_its_worker_loses_is_not_flown_anew(
    cluster: Cluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with dask_executor("dask", cluster.address, 1, 60.0) as executor:
        # The coordinator has the result, and is cut off before the scheduler hears so.
        send = executor._client._send_to_scheduler
        monkeypatch.setattr(
            executor._client,
            "_send_to_scheduler",
            lambda message: None if message["op"] == "client-releases-keys" else send(message),
        )
        wait_for(lambda: executor.workers == 2)
        assert fly(executor, [job(tmp_path)])["0000"].status == "ok"
        ((state, (keeps,)),) = on_scheduler(executor, states)
        assert state == "memory"
        os.kill(executor._client.run(os.getpid, workers=[keeps])[keeps], signal.SIGKILL)
        wait_for(lambda: [s for s in on_scheduler(executor, states) if s[0] == "memory" and s[1] != [keeps]])
        assert len(cluster.flights.read_text().splitlines()) == 1
