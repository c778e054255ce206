"""Missions in processes of this machine: what ends one ends no other, and nothing outlives its campaign."""

import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import fake_missions  # noqa: F401  registers the fidelity
import psutil
import pytest

from nbv.config import MissionConfig
from nbv.mission.result import MissionResult
from nbv.mission.run_directory import WORKER_LOG
from tuner.missions.job import MissionJob, Trial
from tuner.missions.pool import Executor, MissionPool
from tuner.missions.run_jobs import JobList, Stop
from tuner.missions.run_jobs import run_jobs as fly_all


def job(directory: Path, rock: str = "a", number: int = 0, fidelity: str = "fake") -> MissionJob:
    return MissionJob(
        f"{number:04d}", MissionConfig(), rock, 0, directory / f"{number:04d}", fidelity=fidelity
    )


def run_jobs(executor: Executor, jobs: list[MissionJob]) -> dict[str, Trial]:
    """How each mission ended, run again as a campaign would."""
    ended: dict[str, Trial] = {}
    fly_all(JobList(jobs, on_end=lambda trial: ended.update({trial.record.job_id: trial})), executor, Stop())
    return ended


def pool(workers: int = 1, timeout_s: float = 60.0) -> MissionPool:
    return MissionPool(workers, timeout_s, "fake")


def wait_until(holds, within_s: float = 30.0) -> None:
    deadline = time.monotonic() + within_s
    while not holds():
        assert time.monotonic() < deadline
        time.sleep(0.02)


@pytest.mark.parametrize(
    ("rock", "reason", "said"),
    [
        ("kill", "worker_died: SIGKILL", "memory ran out, or somebody ended it"),
        ("abort", "worker_died: SIGABRT", "SIGABRT"),
        ("exit", "worker_died: exit 3", "without a result"),
        ("hang", "timeout", "--timeout-s"),
        ("stop", "timeout", "--timeout-s"),
        ("late", "timeout", "--timeout-s"),  # it has left a result, and does not end
        ("hog", "out_of_memory", "memory"),
        ("raise", "mission_error", "RuntimeError: an exception nobody expected (fake_missions.py, line"),
    ],
)
def test_a_mission_that_ends_badly_fails_alone_with_its_reason(rock, reason, said, tmp_path):
    """Beside one that goes well in the other process, and before one that does in its own."""
    jobs = [job(tmp_path, rock, 0), job(tmp_path, "slow", 1), job(tmp_path, "a", 2)]
    with pool(2, timeout_s=2.5) as executor:
        ended = run_jobs(executor, jobs)
    assert [ended[f"000{n}"].record.status for n in (1, 2)] == ["ok", "ok"]
    assert (ended["0000"].record.status, ended["0000"].reason) == ("failed", reason)
    assert said in ended["0000"].record.message
    left = MissionResult.load(tmp_path / "0000")
    assert (left.status, left.reason) == ("failed", reason), "a resume finds the same"


def test_a_mission_that_hangs_leaves_where_it_was_and_nothing_that_it_started(tmp_path: Path) -> None:
    with pool(timeout_s=1.5) as executor:
        assert run_jobs(executor, [job(tmp_path, "start")])["0000"].reason == "timeout"
    assert "fake_missions.py" in (tmp_path / "0000" / WORKER_LOG).read_text()
    started = int((tmp_path / "0000" / "started.txt").read_text())
    wait_until(lambda: not psutil.pid_exists(started))


@pytest.mark.parametrize("accident", ["kill", "abort", "exit", "hog", "full"])
def test_what_may_be_the_machine_s_doing_is_flown_again(tmp_path: Path, accident: str) -> None:
    with pool() as executor:
        assert run_jobs(executor, [job(tmp_path, f"once-{accident}")])["0000"].record.status == "ok"


def test_a_cancelled_mission_ends_at_once(tmp_path: Path) -> None:
    with pool() as executor:
        future = executor.submit(job(tmp_path, "hang"))
        wait_until(lambda: (tmp_path / "0000" / WORKER_LOG).exists())
        (worker,) = executor._busy
        future.cancel()
        wait_until(lambda: not psutil.pid_exists(worker._process.pid or 0), within_s=2.0)
    assert not (tmp_path / "0000" / "mission.json").exists(), "a resume runs it again"


def test_missions_go_on_when_the_process_that_starts_them_was_killed(tmp_path: Path) -> None:
    def meanwhile() -> None:
        wait_until(lambda: (tmp_path / "0000" / "once.txt").exists())
        (worker,) = executor._busy
        psutil.Process(psutil.Process(worker._process.pid).ppid()).kill()

    with pool(timeout_s=600.0) as executor:
        thread = threading.Thread(target=meanwhile)
        thread.start()
        assert run_jobs(executor, [job(tmp_path, "once-hang")])["0000"].record.status == "ok"
        thread.join()


COORDINATOR = """
import pathlib, sys
from test_pool import job, pool
pool().submit(job(pathlib.Path(sys.argv[1]), "start")).result()
"""


def test_nothing_outlives_a_killed_coordinator(tmp_path: Path) -> None:
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(Path(__file__).parent), *sys.path])}
    with subprocess.Popen([sys.executable, "-c", COORDINATOR, tmp_path], env=environment) as coordinator:
        wait_until(lambda: (tmp_path / "0000" / "started.txt").exists())
        below = psutil.Process(coordinator.pid).children(recursive=True)
        assert len(below) >= 3  # the process that starts missions, a mission's, and what that started
        coordinator.kill()
    assert not psutil.wait_procs(below, timeout=10.0)[1]


SCRIPT = """
import pathlib, sys
from test_pool import job, pool
print(pool().submit(job(pathlib.Path(sys.argv[1]))).result().record.status)
"""


def test_a_script_needs_no_guard_and_nothing_in_its_directory_is_run(tmp_path: Path) -> None:
    here = tmp_path / "here"
    (here / "nbv").mkdir(parents=True)
    for module in ("numpy.py", "json.py", "nbv/__init__.py"):
        (here / module).write_text(f"open({str(tmp_path / 'foreign')!r}, 'w')\nraise SystemExit(3)\n")
    (tmp_path / "script.py").write_text(SCRIPT)
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(Path(__file__).parent), *sys.path])}
    command = [sys.executable, tmp_path / "script.py", tmp_path / "missions"]
    done = subprocess.run(command, env=environment, cwd=here, capture_output=True, text=True)
    assert (done.stdout, done.stderr) == ("ok\n", "")
    assert not (tmp_path / "foreign").exists()


CTRL_C = """
import pathlib, signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)  # a background job of a shell ignores it
from test_pool import job, pool
from tuner.missions.run_jobs import stop_signals
from tuner.missions.run_jobs import JobList, run_jobs
with stop_signals() as stop, pool(2) as executor:
    run_jobs(JobList([job(pathlib.Path(sys.argv[1]), rock, n) for n, rock in enumerate(["a", "hang"])]), executor, stop)
"""


@pytest.mark.parametrize("loads", [True, False])  # the process that starts missions; or one runs
def test_ctrl_c_ends_missions_at_once_without_a_word(loads: bool, tmp_path: Path) -> None:
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(Path(__file__).parent), *sys.path])}
    command = [sys.executable, "-c", CTRL_C, tmp_path]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT}
    with subprocess.Popen(command, env=environment, start_new_session=True, **pipes) as coordinator:
        me = psutil.Process(coordinator.pid)
        if loads:
            wait_until(lambda: len(me.children()) >= 2)
        else:
            wait_until(lambda: (tmp_path / "0001" / WORKER_LOG).exists())
        below = me.children(recursive=True)
        began = time.monotonic()
        os.killpg(coordinator.pid, signal.SIGINT)  # as a terminal does
        assert coordinator.wait(10.0) == 0
        took_s = time.monotonic() - began
        assert coordinator.stdout is not None and coordinator.stdout.read() == b""
    assert took_s < 5.0  # a second, where nothing else runs
    assert not psutil.wait_procs(below, timeout=20.0)[1]
