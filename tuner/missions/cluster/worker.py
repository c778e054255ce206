"""What a worker does: it runs one mission, in a process of its own, and sends back the directory that it left.

It runs in threads of Dask's workers; nothing but bytes and JSON goes over the network, beside the names of these functions.
"""

from __future__ import annotations

import dataclasses
import io
import shutil
import tempfile
import threading
import time
import uuid
import zipfile
from pathlib import Path
from typing import Any

from distributed import Worker, get_worker
from distributed.protocol.pickle import dumps
from distributed.utils import sync
from distributed.worker import WORKER_ANY_RUNNING

from nbv.cache import home
from nbv.mission.run_directory import RESULT
from nbv.provenance import MISSION_LIBRARIES, versions
from nbv.safe_files import write_atomic
from tuner.missions.executors import LocalProcessExecutor
from tuner.missions.job import MissionJob, Trial
from tuner.missions.registry import code_of

_POLL_S = 0.2
_ANSWER_S = 30.0
_FRESH_S = 2.0  # an older answer says nothing: the scheduler may have given this worker up since
_own = threading.local()  # one executor per thread of a worker


def identity(job: MissionJob | None = None) -> dict[str, str]:
    """Return what must be the same on coordinator, scheduler and workers; for a job also libraries, code and plug-ins."""
    installed = versions()
    names = ("python", "gatetune", *(MISSION_LIBRARIES if job else ()))
    facts = {name: installed[name] for name in names if name in installed}
    if job is not None:
        facts[f"the code of {job.fidelity}"] = code_of(job.fidelity)[:12]
        for plugin in job.planners:
            facts[f"the code of {plugin.label}"] = plugin.source[:12]
    return facts


def difference(theirs: dict[str, str], here: dict[str, str], whose: str) -> str:
    """Return the first thing in which they and the coordinator differ, both named; empty where there is none."""
    for name in {**here, **theirs}:
        if theirs.get(name) != here.get(name):
            return (
                f"{name} is {theirs.get(name, 'missing')} on the {whose} and {here.get(name, 'missing')} here; "
                "install the same on both"
            )
    return ""


def received_rock(sha256: str) -> Path:
    """Return the file in which a rock of that content is kept for workers."""
    return home() / "rocks" / "received" / f"{sha256}.npz"


def run_order(order: dict[str, Any], rock: bytes | None) -> dict[str, Any]:
    """Run the mission of ``order`` and return how it ended, with its files; ``rock`` is one that workers cannot make themselves."""
    worker = get_worker()
    job = MissionJob.from_dict(order["job"])
    directory = Path(tempfile.mkdtemp(prefix=f"mission-{job.id}-", dir=worker.local_directory))
    try:
        if why := difference(identity(job), order["identity"], "worker"):
            trial = job.failed("user_error", f"worker {worker.address}: {why}")
        else:
            if rock is not None:
                path = received_rock(order["rock_sha256"])
                if not path.is_file():  # a new file would be read again
                    path.parent.mkdir(parents=True, exist_ok=True)
                    write_atomic(path, rock)
                job = dataclasses.replace(job, rock=str(path))
            trial = _run(dataclasses.replace(job, directory=directory), order["timeout_s"])
        ended = {"reason": trial.reason, "message": trial.record.message, "wall_s": trial.record.wall_s}
        return {**ended, "files": pack(directory)}
    finally:
        shutil.rmtree(directory, ignore_errors=True)


def _run(job: MissionJob, timeout_s: float) -> Trial:
    key = (job.fidelity, timeout_s)
    if getattr(_own, "key", None) != key:
        if hasattr(_own, "executor"):
            _own.executor.close()
        _own.executor, _own.key = LocalProcessExecutor(1, timeout_s, (job.fidelity,)), key
    executor: LocalProcessExecutor = _own.executor
    executor.begin()
    task = get_worker().get_current_task()
    if not _granted(get_worker(), task):
        return job.failed("worker_killed", "the worker that had it was lost")
    executor.submit(job)
    while True:
        if ended := executor.wait_any(_POLL_S):
            return ended[0]
        if not _wanted(task):
            executor.cancel_all()
            return job.failed("worker_stopped", "the coordinator no longer wants it")


def grant(task: str, address: str, attempt: str, dask_scheduler: Any) -> bool:
    """On the scheduler, return whether ``attempt`` may begin; one attempt of a task is told so, ever.

    A scheduler makes anew what lay on a lost worker, whether or not the coordinator has it, and a worker that was cut off
    would go through all that had been sent to it. Who runs again decides the coordinator alone, by another task.
    """
    state = dask_scheduler.tasks.get(task)
    worker = dask_scheduler.workers.get(dask_scheduler.coerce_address(address))  # it may be given by a name
    if state is None or worker is None or state.processing_on is not worker:
        return False
    state.annotations = {"attempt": attempt, **(state.annotations or {})}
    return bool(state.annotations["attempt"] == attempt)


def _granted(here: Worker, task: str) -> bool:
    arguments = dumps((task, here.address, uuid.uuid4().hex))

    async def ask() -> Any:
        return await here.scheduler.run_function(function=dumps(grant), args=arguments)

    while True:
        asked_at = time.monotonic()
        try:
            answer = sync(here.loop, ask, callback_timeout=_ANSWER_S)
        except (OSError, TimeoutError):
            return False  # cut off
        if not answer["result"]:
            return False
        if time.monotonic() - asked_at < _FRESH_S:
            return True


def _wanted(task: str) -> bool:
    """Return whether the coordinator still waits for this task, and can hear of it: Dask does not stop one that runs."""
    here = get_worker()
    state = here.state.tasks.get(task)
    return (
        here.status in WORKER_ANY_RUNNING
        and state is not None
        and state.state in ("executing", "long-running")
    )


def pack(directory: Path) -> bytes:
    """Return a mission's files, its result last: its presence means that the mission has finished.

    Links and pipes are left out, which would lead elsewhere at the coordinator's.
    """
    files = [path for path in directory.rglob("*") if path.is_file() and not path.is_symlink()]
    buffer = io.BytesIO()
    with zipfile.ZipFile(
        buffer, "w", zipfile.ZIP_DEFLATED, compresslevel=1, strict_timestamps=False
    ) as archive:
        for path in sorted(files, key=lambda path: path == directory / RESULT):
            archive.write(path, path.relative_to(directory))
    return buffer.getvalue()


def unpack(files: bytes, directory: Path) -> None:
    """Write a mission's files into ``directory``, and nowhere else, whatever they are called."""
    with zipfile.ZipFile(io.BytesIO(files)) as archive:
        archive.extractall(directory)
