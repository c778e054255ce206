"""Missions on other machines, by Dask (extra ``cluster``): the coordinator, which has model and ledger, is a scheduler's client.

A worker runs each mission in a process of its own, as `tuner.missions.pool` does, and sends back the directory that it left. Nothing but
bytes and JSON goes over the network, beside the names of these functions.
"""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import io
import logging
import multiprocessing
import shutil
import tempfile
import time
import uuid
import zipfile
from concurrent import futures
from pathlib import Path
from typing import Any

import dask
import distributed

from nbv.cache import Store, home
from nbv.errors import UserError
from nbv.mission.run_directory import RESULT
from nbv.provenance import MISSION_LIBRARIES, versions
from nbv.rocks import load_rock
from nbv.rocks.catalogue import write_rock
from nbv.rocks.families import generated_name
from nbv.rocks.recipes import RECIPES
from nbv.safe_files import write_atomic
from tuner.missions.job import MissionJob, Trial, load_trial, remove_earlier_result
from tuner.missions.pool import MAX_WORKERS, Executor, MissionPool, settle
from tuner.missions.registry import code_of, mission_kind

_CONNECT_S = 20.0
_RECONNECT_S = 10.0
_COUNTED_EVERY_S = 1.0
_POLL_S = 0.2
_WORKER_LOST = ("KilledWorker", "CommClosedError", "CancelledError", "FutureCancelledError", "TimeoutError")


class DaskPool(Executor):
    """Missions on the workers of a scheduler, as many at a time as their threads; workers may come and go.

    ``scheduler``: its address, or the file that it writes (``dask scheduler --scheduler-file``). `UserError` where none answers.
    """

    def __init__(self, scheduler: str, timeout_s: float) -> None:
        super().__init__(timeout_s)
        dask.config.set({"distributed.admin.large-graph-warning-threshold": "1GB"})  # rocks are sent
        for name in ("distributed", "distributed.client", "asyncio"):
            logging.getLogger(name).setLevel(logging.CRITICAL)  # what matters comes back as an outcome
        there = {"address": scheduler} if "://" in scheduler else {"scheduler_file": scheduler}
        if "scheduler_file" in there and not Path(scheduler).is_file():
            raise UserError(f"--scheduler {scheduler}: no such file, nor an address such as tcp://HOST:8786")
        try:
            self._client = distributed.Client(
                **there, timeout=_CONNECT_S, set_as_default=False, name="gatetune"
            )
        except (OSError, TimeoutError, ValueError, TypeError, RuntimeError) as error:
            raise UserError(
                f"no Dask scheduler answers at {scheduler} ({str(error) or type(error).__name__}); start one with "
                "`dask scheduler`; tls:// needs Dask's TLS settings"
            ) from error
        self._rocks: dict[str, tuple[str, distributed.Future]] = {}  # hash and content
        self._counted, self._count = -_COUNTED_EVERY_S, 0

    @property
    def workers(self) -> int:
        """Missions that the workers of this moment run at a time."""
        now = time.monotonic()
        if now - self._counted >= _COUNTED_EVERY_S:
            with contextlib.suppress(OSError, TimeoutError, KeyError):  # cut off for the moment
                known = self._client.scheduler_info(n_workers=-1)["workers"].values()
                self._count = sum(w["nthreads"] for w in known)
            self._counted = now
        return self._count

    @property
    def capacity(self) -> int:
        """`workers`; 1 while there are none, so that a mission waits for the first."""
        return max(1, self.workers)

    def submit(self, job: MissionJob) -> futures.Future[Trial]:
        self._require_scheduler()
        job.directory.mkdir(parents=True, exist_ok=True)
        remove_earlier_result(job)
        rock_sha256, rock = self._rock(job)
        order = {
            "job": job.to_dict(),
            "rock_sha256": rock_sha256,
            "timeout_s": self._timeout_s,
            "identity": identity(job),
        }
        # A key of its own: Dask would take an equal mission for the same one.
        task = self._client.submit(run_order, order, rock, key=f"{job.id}-{uuid.uuid4().hex}", pure=False)
        future: futures.Future[Trial] = futures.Future()
        future.add_done_callback(functools.partial(self._forget, task))
        began = time.monotonic()
        task.add_done_callback(lambda ended: settle(future, lambda: self._trial(job, ended, began)))
        return future

    def _forget(self, task: distributed.Future, future: futures.Future[Trial]) -> None:
        with contextlib.suppress(OSError, TimeoutError):
            if future.cancelled() and self._client.status == "running":
                self._client.cancel([task], force=True, asynchronous=False)
            task.release()  # a scheduler makes anew what is wanted still where a worker is lost

    def _rock(self, job: MissionJob) -> tuple[str, distributed.Future | None]:
        """Return hash and content of a rock that workers cannot make themselves; Dask takes it where it is needed."""
        made_there = job.rock in RECIPES or generated_name(job.rock) is not None
        if made_there or not mission_kind(job.fidelity).uses_catalogue:
            return "", None
        if job.rock not in self._rocks or self._rocks[job.rock][1].status not in ("pending", "finished"):
            rock = load_rock(job.rock, Store())
            path = _received_rock(rock.sha256)
            write_rock(rock, path)
            content = self._client.submit(bytes, path.read_bytes(), key=f"rock-{uuid.uuid4().hex}")
            self._rocks[job.rock] = rock.sha256, content
        return self._rocks[job.rock]

    def _trial(self, job: MissionJob, task: distributed.Future, began: float) -> Trial:
        """The trial of a task that has ended; of one without an answer, why there is none."""
        if task.status in ("cancelled", "lost"):
            self._require_scheduler()
            return job.failed("server_lost", "the way to the scheduler was cut")
        try:
            answer = task.result(timeout=_RECONNECT_S)
        except Exception as error:  # whatever the worker, or the way to it, raised
            name, wall_s = type(error).__name__, time.monotonic() - began
            if name in _WORKER_LOST:
                return job.failed("worker_lost", f"the worker died or left ({name})", wall_s)
            if isinstance(error, UserError):  # such as a plug-in that is not installed there
                return job.failed("user_error", f"a worker refuses: {error}", wall_s)
            if isinstance(error, ImportError):
                why = f"a worker cannot import this program ({error}); install it there"
                return job.failed("user_error", why, wall_s)
            return job.failed("machine_error", f"{name}: {error}", wall_s)
        with zipfile.ZipFile(io.BytesIO(answer["files"])) as archive:
            archive.extractall(job.directory)
        overran = answer["reason"] == "timeout"
        trial = None if overran else load_trial(job, answer["wall_s"])
        return trial or job.failed(answer["reason"], answer["message"], answer["wall_s"])

    def _require_scheduler(self) -> None:
        deadline = time.monotonic() + _RECONNECT_S
        while self._client.status != "running":
            if time.monotonic() > deadline:
                raise UserError("the Dask scheduler is gone; start it again, then resume the campaign")
            time.sleep(0.05)

    def close(self) -> None:
        with contextlib.suppress(OSError, TimeoutError):
            self._client.close(timeout=_RECONNECT_S)


def identity(job: MissionJob) -> dict[str, str]:
    """Return what must be the same on coordinator and workers."""
    installed = versions()
    names = ("python", "gatetune", *MISSION_LIBRARIES)
    facts = {name: installed[name] for name in names if name in installed}
    facts[f"the code of {job.fidelity}"] = code_of(job.fidelity)[:12]
    for plugin in job.config.plugins_used:
        facts[f"the code of {plugin.label}"] = plugin.source[:12]
    return facts


def _received_rock(sha256: str) -> Path:
    """Return the file in which a rock of that content is kept for workers."""
    return home() / "rocks" / "received" / f"{sha256}.npz"


def run_order(order: dict[str, Any], rock: bytes | None) -> dict[str, Any]:
    """On a worker, run a mission and return how it ended, with its files; ``rock`` is one that workers cannot make themselves."""
    worker = distributed.get_worker()
    job = MissionJob.from_dict(order["job"])
    here, there = identity(job), order["identity"]
    for name in {**there, **here}:
        if here.get(name) != there.get(name):
            raise UserError(
                f"worker {worker.address}: {name} is {here.get(name, 'missing')} there and {there.get(name, 'missing')} here; "
                "install the same on both"
            )
    if rock is not None:
        path = _received_rock(order["rock_sha256"])
        if not path.is_file():  # a new file would be read again
            path.parent.mkdir(parents=True, exist_ok=True)
            write_atomic(path, rock)
        job = dataclasses.replace(job, rock=str(path))
    directory = Path(tempfile.mkdtemp(prefix=f"mission-{job.id}-", dir=worker.local_directory))
    try:
        trial = _run(dataclasses.replace(job, directory=directory), order["timeout_s"])
        ended = {"reason": trial.reason, "message": trial.record.message, "wall_s": trial.record.wall_s}
        return {**ended, "files": _pack(directory)}
    finally:
        shutil.rmtree(directory, ignore_errors=True)


@functools.cache
def _pool(fidelity: str, timeout_s: float) -> MissionPool:
    multiprocessing.current_process().daemon = False  # Dask's workers are, and those may not have processes
    return MissionPool(MAX_WORKERS, timeout_s, fidelity)


def _run(job: MissionJob, timeout_s: float) -> Trial:
    """Run a mission until it ends, or the coordinator no longer waits for it: Dask does not stop a task that runs."""
    task = distributed.get_worker().get_current_task()
    mission = _pool(job.fidelity, timeout_s).submit(job)
    while not futures.wait([mission], _POLL_S).done:
        state = distributed.get_worker().state.tasks.get(task)
        if state is None or state.state not in ("executing", "long-running"):
            mission.cancel()
            return job.failed("worker_lost", "the coordinator no longer waits for it")
    return mission.result()


def _pack(directory: Path) -> bytes:
    """Return a mission's files, its result last: its presence means that the mission has finished."""
    files = [path for path in directory.rglob("*") if path.is_file() and not path.is_symlink()]
    buffer = io.BytesIO()
    with zipfile.ZipFile(
        buffer, "w", zipfile.ZIP_DEFLATED, compresslevel=1, strict_timestamps=False
    ) as archive:
        for path in sorted(files, key=lambda path: path == directory / RESULT):
            archive.write(path, path.relative_to(directory))
    return buffer.getvalue()
