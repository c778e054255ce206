"""The project's own mission processes against two libraries': the same missions, and the same accidents.

    pip install pebble
    python benchmarks/mission_processes.py [--rounds 3] [--geometric 30] [--photogrammetric 3]

``own`` is `tuner.missions.executors.LocalProcessExecutor`. ``pebble`` is `pebble.ProcessPool` and ``futures``
`concurrent.futures.ProcessPoolExecutor`, both on a forkserver that has imported the mission's modules, with a process
of its own for every mission (``max_tasks=1``), as isolation asks for. One worker; the rounds take turns. Warm-up
missions come before the clock, so that rocks, ray casting and photographs are in the store, as in a campaign.

Accidents: a mission that aborts, one that hangs behind a process that it started, and a campaign that is killed.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import multiprocessing
import os
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import Any

import numpy as np

from nbv.config import MissionConfig, preset
from nbv.mission import MissionResult
from nbv.threads import single_thread_environment
from tuner.missions.executors import LocalProcessExecutor
from tuner.missions.job import LOG_FILE, MissionJob
from tuner.missions.run_job import run_job

HANG_S = 600.0
TIMEOUT_S = 3.0
MODULE = "mission_processes"


def accident(
    config: MissionConfig, rock: str, replicate: int, directory: Path, *, keep: str = "summary"
) -> MissionResult:
    """A mission runner: ``abort`` aborts, ``hang`` sleeps beside a sleeping child process, others end at once."""
    if rock == "abort":
        os.abort()
    if rock == "hang":
        child = subprocess.Popen([sys.executable, "-c", f"import time; time.sleep({HANG_S})"])
        (directory / "child").write_text(str(child.pid))
        time.sleep(HANG_S)
    return MissionResult("ok", "", "", config.digest(), rock, replicate, {}, [], {}, {})


def fly_into_log(tree: dict[str, Any]) -> int:
    """A job in a library's process: what it prints goes to its log, as the project's own server does it."""
    Path(tree["directory"]).mkdir(parents=True, exist_ok=True)
    with (Path(tree["directory"]) / LOG_FILE).open("ab") as log:
        os.dup2(log.fileno(), 1)
        os.dup2(log.fileno(), 2)
    return run_job(tree)


def forkserver(module: str) -> Any:
    """A context whose server has imported what missions need."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload([module, MODULE])
    return context


class Own:
    """The project's."""

    name = "own"

    def __init__(self, module: str, timeout_s: float = 3600.0) -> None:
        self._executor = LocalProcessExecutor(1, timeout_s, preload=(module,))

    def fly(self, jobs: list[MissionJob]) -> list[str]:
        """How each ended, one after the other."""
        endings = []
        for job in jobs:
            self._executor.submit(job)
            while self._executor.in_flight:
                endings += [outcome.reason or outcome.status for outcome in self._executor.wait_any(1.0)]
        return endings

    def close(self) -> None:
        """End it."""
        self._executor.close()


class Futures:
    """The standard library's."""

    name = "futures"

    def __init__(self, module: str, timeout_s: float = 3600.0) -> None:
        self._timeout_s = timeout_s
        self._pool = ProcessPoolExecutor(1, mp_context=forkserver(module), max_tasks_per_child=1)

    def fly(self, jobs: list[MissionJob]) -> list[str]:
        """How each ended, one after the other."""
        return [self._ending(job) for job in jobs]

    def _ending(self, job: MissionJob) -> str:
        try:
            future: Future[int] = self._pool.submit(fly_into_log, job.to_dict())
            return f"exit {future.result(self._timeout_s)}"
        except BrokenProcessPool:
            return "the pool is broken"
        except TimeoutError:
            return "given up, still running"

    def close(self) -> None:
        """End it, and what still runs."""
        for process in list((self._pool._processes or {}).values()):
            process.kill()
        self._pool.shutdown(wait=False, cancel_futures=True)


class Pebble:
    """Pebble's."""

    name = "pebble"

    def __init__(self, module: str, timeout_s: float = 3600.0) -> None:
        from pebble import ProcessPool

        self._timeout_s = timeout_s
        self._pool = ProcessPool(max_workers=1, max_tasks=1, context=forkserver(module))

    def fly(self, jobs: list[MissionJob]) -> list[str]:
        """How each ended, one after the other."""
        return [self._ending(job) for job in jobs]

    def _ending(self, job: MissionJob) -> str:
        from pebble import ProcessExpired

        try:
            future = self._pool.schedule(fly_into_log, args=[job.to_dict()], timeout=self._timeout_s)
            return f"exit {future.result()}"
        except ProcessExpired as error:
            return f"worker died: {error.exitcode}"
        except TimeoutError:
            return "timeout"

    def close(self) -> None:
        """End it."""
        self._pool.stop()
        self._pool.join()


KINDS: dict[str, Callable[..., Any]] = {kind.name: kind for kind in (Own, Pebble, Futures)}


def jobs(count: int, runner: str, folder: Path) -> list[MissionJob]:
    """Missions on one rock, each with other weights; the same in every round, so that what is kept of them is there."""
    rng = np.random.default_rng(0)
    paths = [f"{scorer}.weights.{w}" for scorer in ("covis", "b_aware") for w in ("nov", "move", "ang")]
    found = []
    for i in range(count):
        config = preset("campaign").with_values({path: float(10 ** rng.uniform(-2, 0.3)) for path in paths})
        found.append(MissionJob(f"{i:04d}", config, "boulder", 0, folder / f"{i:04d}", runner=runner))
    return found


def race(runner: str, count: int, rounds: int, names: list[str]) -> dict[str, list[float]]:
    """Seconds per mission of each round; the processes stay up from round to round."""
    flyers = {name: KINDS[name](runner.partition(":")[0]) for name in names}
    seconds: dict[str, list[float]] = {name: [] for name in names}
    with tempfile.TemporaryDirectory() as folder:
        for round_ in range(rounds + 1):  # round 0 warms up
            for name, flyer in flyers.items():
                flown = jobs(count, runner, Path(folder) / name / str(round_))
                started = time.perf_counter()
                endings = flyer.fly(flown)
                elapsed_s = time.perf_counter() - started
                if set(endings) - {"ok", "exit 0"}:
                    raise SystemExit(f"{name}: {endings}")
                if round_:
                    seconds[name].append(elapsed_s / count)
    for flyer in flyers.values():
        flyer.close()
    return seconds


def alive(pid_file: Path) -> bool:
    """Whether the process that a mission started outlived it; it is ended here if so."""
    if not pid_file.is_file():
        return False
    time.sleep(0.5)
    pid = int(pid_file.read_text())
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return False
    if state == "Z":
        return False
    with contextlib.suppress(ProcessLookupError):
        os.kill(pid, signal.SIGKILL)
    return True


def accidents(name: str) -> dict[str, Any]:
    """How each accident ends, and what survives it."""
    endings = {}
    with tempfile.TemporaryDirectory() as folder:
        for first in ("abort", "hang"):
            flyer = KINDS[name](MODULE, TIMEOUT_S)
            flown = [
                MissionJob(
                    rock, MissionConfig(), rock, 0, Path(folder) / first / rock, runner=f"{MODULE}:accident"
                )
                for rock in (first, "plain")
            ]
            endings[first], endings[f"the mission after {first}"] = flyer.fly(flown)
            endings["child of the hung mission outlives it"] = alive(flown[0].directory / "child")
            flyer.close()
    return {**endings, **killed_campaign(name)}


def killed_campaign(name: str) -> dict[str, Any]:
    """A campaign process in the middle of a mission is killed outright: does the mission's work go on?"""
    with tempfile.TemporaryDirectory() as folder:
        code = (
            "import sys; from pathlib import Path; import mission_processes as m\n"
            f"job = m.MissionJob('hang', m.MissionConfig(), 'hang', 0, Path({folder!r}) / 'hang', "
            "runner='mission_processes:accident')\n"
            f"m.KINDS[{name!r}]('mission_processes').fly([job])\n"
        )
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
        campaign = subprocess.Popen([sys.executable, "-c", code], env=environment, start_new_session=True)
        child = Path(folder) / "hang" / "child"
        deadline = time.monotonic() + 60
        while not child.is_file() and time.monotonic() < deadline:
            time.sleep(0.1)
        time.sleep(0.2)
        campaign.kill()
        campaign.wait()
        time.sleep(2.0)
        outlives = alive(child)
        with contextlib.suppress(ProcessLookupError):
            os.killpg(campaign.pid, signal.SIGKILL)
        return {"mission outlives a killed campaign": outlives}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--geometric", type=int, default=30, help="Missions a round.")
    parser.add_argument("--photogrammetric", type=int, default=3, help="Missions a round.")
    parser.add_argument("--only", nargs="+", choices=list(KINDS), default=list(KINDS))
    arguments = parser.parse_args()
    single_thread_environment()
    for fidelity, runner, count in (
        ("geometric", "nbv.geometric:run_geometric_mission", arguments.geometric),
        ("photogrammetric", "nbv.photogrammetric:run_photogrammetric_mission", arguments.photogrammetric),
    ):
        if not count:
            continue
        seconds = race(runner, count, arguments.rounds, arguments.only)
        for name, values in seconds.items():
            ratios = [own / other for own, other in zip(seconds.get("own", values), values)]
            print(
                f"{fidelity:16s} {name:8s} {statistics.median(values):7.3f} s a mission "
                f"(rounds {', '.join(f'{v:.3f}' for v in values)}); own / this {statistics.median(ratios):.2f}"
            )
    for name in arguments.only:
        print(name, json.dumps(accidents(name)))


if __name__ == "__main__":
    main()
