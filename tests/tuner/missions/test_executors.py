import json
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

import tuner.missions.executors as executors
from nbv.config import MissionConfig, preset
from tuner.missions.executors import Executor, LocalProcessExecutor
from tuner.missions.job import MAX_ATTEMPTS, MissionJob, Trial, load_trial
from tuner.missions.long_runs import Stop
from tuner.missions.run_job import EXIT_NOT_WRITABLE, run_job
from tuner.missions.run_jobs import JobList
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


@pytest.mark.parametrize("happens", [signal.SIGKILL, signal.SIGSTOP])
def test_a_mission_is_flown_again_when_its_server_ends_or_stands_still(
    happens: signal.Signals, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """While its first flight hangs."""
    monkeypatch.setattr(executors, "_SILENCE_LIMIT_AFTER_KILL_S", 2.0)

    def meanwhile() -> None:
        while not (tmp_path / "0000" / "once.txt").exists():
            time.sleep(0.02)
        os.kill(executor._server.pid, happens)

    with LocalProcessExecutor(1, 2.0 if happens == signal.SIGSTOP else 600.0, preload=("fake",)) as executor:
        thread = threading.Thread(target=meanwhile)
        thread.start()
        assert run_jobs(executor, [job(tmp_path, "once-hang")])["0000"].record.status == "ok"
        thread.join()


COORDINATOR = """
import pathlib, sys
from test_executors import job
from tuner.missions.executors import LocalProcessExecutor
executor = LocalProcessExecutor(1, preload=("fake",))
executor.submit(job(pathlib.Path(sys.argv[1]), "once-hang"))
while True:
    executor.wait_any(1.0)
"""


@pytest.mark.parametrize("flies", [False, True])  # its server still imports, or has a mission
def test_nothing_outlives_a_killed_coordinator_though_its_server_was_stopped(
    flies: bool, tmp_path: Path
) -> None:
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(Path(__file__).parent), *sys.path])}
    with subprocess.Popen([sys.executable, "-c", COORDINATOR, tmp_path], env=environment) as coordinator:
        server: list[psutil.Process] = []
        # A child that has not become the server yet is a copy of the coordinator, and cannot wake.
        while not server or "tuner.missions.server" not in server[0].cmdline():
            time.sleep(0.02)
            server = psutil.Process(coordinator.pid).children()
        while flies and not (tmp_path / "0000" / "once.txt").exists():
            time.sleep(0.02)
        below = server + server[0].children(recursive=True)
        assert len(below) > 2 or not flies  # a mission and its keeper
        server[0].suspend()
        coordinator.kill()
    assert not psutil.wait_procs(below, timeout=120.0)[1]


@pytest.mark.parametrize("accident", ["kill", "stop", "abort"])
def test_what_the_machine_ended_is_flown_again(tmp_path: Path, accident: str) -> None:
    with LocalProcessExecutor(1, 2.0, preload=("fake",)) as executor:
        assert run_jobs(executor, [job(tmp_path, f"once-{accident}")])["0000"].record.status == "ok"


@pytest.mark.slow
def test_a_mission_with_rendered_photographs_runs_on_a_worker(tmp_path: Path) -> None:
    small = {"seed.count": 16, "stop.adaptive_budget": 2, "dense.agreeing_views": 3}
    config = preset("campaign").with_values({**small, "evaluation.gt_samples": 10_000})
    with LocalProcessExecutor() as executor:
        ended = run_jobs(executor, [MissionJob("0", config, "boulder", 0, tmp_path / "0")])
    assert ended["0"].record.status == "ok", ended["0"].record.message


def test_a_full_disk_for_result_and_log_is_the_machine_s(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("tuner.missions.run_job.write_atomic", full)
    monkeypatch.setattr("tuner.missions.run_job.record_failure", full)
    monkeypatch.setattr("traceback.print_exception", full)
    assert run_job(job(tmp_path).to_dict()) == EXIT_NOT_WRITABLE


def test_a_mission_that_is_killed_every_time_is_lost(tmp_path: Path) -> None:
    class Counting(LocalProcessExecutor):
        submitted = 0

        def submit(self, job: MissionJob) -> None:
            self.submitted += 1
            super().submit(job)

    with Counting(1, preload=("fake",)) as executor:
        outcome = run_jobs(executor, [job(tmp_path, "kill")])["0000"]
    assert outcome.infrastructure_failure and outcome.reason == "worker_killed: signal 9"
    assert executor.submitted == MAX_ATTEMPTS


def test_a_server_whose_module_starts_a_thread_begins_again_without_it(tmp_path: Path) -> None:
    (tmp_path / "threaded.py").write_text(
        "import threading, time\nprint('imported', flush=True)\n"
        "threading.Thread(target=time.sleep, args=(60,), daemon=True).start()\n"
    )
    each = job(tmp_path)
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path), *sys.path])}
    command = [sys.executable, "-P", "-m", "tuner.missions.server", "threaded"]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with subprocess.Popen(command, env=environment, text=True, **pipes) as server:
        assert server.stdin and server.stdout and server.stderr
        print(json.dumps({"op": "run", "job": each.to_dict()}), file=server.stdin, flush=True)
        events = (json.loads(line) for line in server.stdout)
        ended = next(event for event in events if event["event"] == "exited")
        threads = len(list(Path(f"/proc/{server.pid}/task").iterdir()))
        server.stdin.close()
        printed = server.stderr.read()
    assert (ended["status"], threads, printed.count("imported\n")) == (0, 1, 1)
    outcome = load_trial(each)
    assert outcome is not None and outcome.record.status == "ok"


def test_nothing_in_the_current_directory_is_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    here = tmp_path / "here"
    (here / "nbv").mkdir(parents=True)
    for module in ("numpy.py", "json.py", "fake_missions.py", "nbv/__init__.py"):
        (here / module).write_text(f"open({str(tmp_path / 'foreign')!r}, 'w')\nraise SystemExit(3)\n")
    monkeypatch.chdir(here)
    monkeypatch.syspath_prepend("")  # as where Python was started with -c
    with LocalProcessExecutor(1, preload=("fake",)) as executor:
        assert run_jobs(executor, [job(tmp_path)])["0000"].record.status == "ok"
    assert not (tmp_path / "foreign").exists()
