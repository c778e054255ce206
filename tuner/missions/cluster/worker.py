"""What a worker does: it flies one mission, in a process of its own, and sends back the directory that it left.

Runs in threads of Dask's workers; nothing but bytes and JSON goes over the network, beside the names of these functions.
"""

from __future__ import annotations

import dataclasses
import io
import shutil
import tarfile
import tempfile
import threading
import time
import uuid
from pathlib import Path
from typing import Any

from distributed import Worker, get_worker
from distributed.protocol.pickle import dumps
from distributed.utils import sync
from distributed.worker import WORKER_ANY_RUNNING

from nbv.cache import home
from nbv.errors import UserError
from nbv.provenance import MISSION_LIBRARIES, versions
from nbv.rocks.imported import read_rock
from tuner.missions.executors import LocalProcessExecutor
from tuner.missions.job import MissionJob, Trial
from tuner.missions.registry import code_of

_POLL_S = 0.2
_ANSWER_S = 30.0
_FRESH_S = 2.0  # an older answer says nothing: the scheduler may have given this worker up since
_own = threading.local()  # one executor per thread of a worker


def identity(fidelity: str = "") -> dict[str, str]:
    """Return what must be the same on coordinator, scheduler and workers; of a fidelity also libraries and code."""
    installed = versions()
    names = ("python", "gatetune", *(MISSION_LIBRARIES if fidelity else ()))
    found = {name: installed[name] for name in names if name in installed}
    return found | ({f"the code of {fidelity}": code_of(fidelity)[:12]} if fidelity else {})


def difference(theirs: dict[str, str], ours: dict[str, str], whose: str = "worker") -> str:
    """The first thing in which a worker and the coordinator differ, both named; empty where there is none."""
    for name in {**ours, **theirs}:
        if theirs.get(name) != ours.get(name):
            return (
                f"{name} is {theirs.get(name, 'missing')} on the {whose} and {ours.get(name, 'missing')} here; "
                "install the same on both"
            )
    return ""


def received_rock(sha256: str) -> Path:
    """Return the file in which a worker keeps the rock of that content."""
    return home() / "rocks" / "received" / f"{sha256}.npz"


def keep_rock(sha256: str, content: bytes) -> None:
    """Keep a rock that the coordinator sent."""
    path = received_rock(sha256)
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.NamedTemporaryFile(dir=path.parent, delete=False) as file:
        file.write(content)
    Path(file.name).replace(path)


def fly(order: dict[str, Any]) -> dict[str, Any]:
    """Fly the mission of ``order`` (see `tuner.missions.cluster.executor`).

    Returns ``{"refused": why}``, ``{"needs": the rock's hash}``, or how it ended with the directory as a tar file.
    """
    worker = get_worker()
    ours = identity(order["job"]["fidelity"])
    if why := difference(ours, order["identity"]):
        return {"refused": f"worker {worker.address}: {why}"}
    job = MissionJob.from_dict(order["job"])
    if sha256 := order["rock_sha256"]:
        path = received_rock(sha256)
        if not _has(path, sha256):
            return {"needs": sha256, "worker": worker.address}
        job = dataclasses.replace(job, rock=str(path))
    directory = Path(tempfile.mkdtemp(prefix=f"mission-{job.id}-", dir=worker.local_directory))
    try:
        trial = _flown(dataclasses.replace(job, directory=directory), order["timeout_s"])
        ended = {name: getattr(trial, name) for name in ("reason", "message", "wall_s")}
        return {**ended, "files": packed(directory)}
    finally:
        shutil.rmtree(directory, ignore_errors=True)


def _has(path: Path, sha256: str) -> bool:
    try:
        return read_rock(path).sha256 == sha256
    except UserError:
        return False


def _flown(job: MissionJob, timeout_s: float) -> Trial:
    key = (job.fidelity, timeout_s)
    if getattr(_own, "key", None) != key:
        if hasattr(_own, "executor"):
            _own.executor.close()
        _own.executor, _own.key = LocalProcessExecutor(1, timeout_s, (job.fidelity,), max_attempts=1), key
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
    would go through all that had been sent to it. Who flies again decides the coordinator alone, by another task.

    Parameters
    ----------
    task
        The task's key.
    address
        The worker that asks.
    attempt
        Identifies this run of the task.
    dask_scheduler
        The scheduler, which Dask passes.
    """
    state = dask_scheduler.tasks.get(task)
    worker = dask_scheduler.workers.get(dask_scheduler.coerce_address(address))  # it may be given by a name
    if state is None or worker is None or state.processing_on is not worker:
        return False
    state.annotations = {"attempt": attempt, **(state.annotations or {})}
    return bool(state.annotations["attempt"] == attempt)


def _granted(here: Worker, task: str) -> bool:
    attempt = uuid.uuid4().hex

    async def ask() -> Any:
        arguments = dumps((task, here.address, attempt))
        return await here.scheduler.run_function(function=dumps(grant), args=arguments)

    while True:
        asked = time.monotonic()
        try:
            answer = sync(here.loop, ask, callback_timeout=_ANSWER_S)
        except (OSError, TimeoutError):
            return False  # cut off
        if not answer["result"]:
            return False
        if time.monotonic() - asked < _FRESH_S:
            return True


def _wanted(task: str) -> bool:
    """Whether the coordinator still waits for this task, and can hear of it: Dask does not stop one that runs."""
    here = get_worker()
    state = here.state.tasks.get(task)
    return (
        here.status in WORKER_ANY_RUNNING
        and state is not None
        and state.state in ("executing", "long-running")
    )


def packed(directory: Path) -> bytes:
    """The files of a mission."""
    buffer = io.BytesIO()
    with tarfile.open(fileobj=buffer, mode="w:gz", compresslevel=1) as archive:
        # A link or a pipe that a mission left would lead elsewhere at the coordinator's.
        archive.add(
            directory, arcname=".", filter=lambda m: m if m.isreg() or m.isdir() or m.islnk() else None
        )
    return buffer.getvalue()


def unpacked(files: bytes, directory: Path, last: str) -> None:
    """Write the files into ``directory``, ``last`` after all others: its presence means that the mission is finished."""
    directory.mkdir(parents=True, exist_ok=True)
    with tarfile.open(fileobj=io.BytesIO(files)) as archive:
        result = [member for member in archive.getmembers() if Path(member.name) == Path(last)]
        archive.extractall(directory, [m for m in archive.getmembers() if m not in result], filter="data")
        for member in result:
            content = archive.extractfile(member)
            assert content is not None
            temporary = directory / f".{last}.{time.monotonic_ns()}"
            temporary.write_bytes(content.read())
            temporary.replace(directory / last)
