"""The coordinator's side: an executor whose missions run on the workers of a Dask scheduler."""

from __future__ import annotations

import contextlib
import logging
import time
import uuid
from dataclasses import dataclass
from typing import Any

from distributed import Client, Future

from nbv.cache import Store
from nbv.errors import UserError
from nbv.rocks import load_rock
from nbv.rocks.catalogue import write_rock
from nbv.rocks.families import generated_name
from nbv.rocks.recipes import RECIPES
from tuner.missions.cluster import worker
from tuner.missions.executors import Executor
from tuner.missions.job import MissionJob, Trial, load_trial, remove_earlier_result
from tuner.missions.registry import mission_kind

_COUNTED_EVERY_S = 1.0
_LOOKED_EVERY_S = 0.01
_RECONNECT_S = 10.0
_WORKER_LOST = ("KilledWorker", "CommClosedError", "CancelledError", "FutureCancelledError", "TimeoutError")


@dataclass
class _Attempt:
    job: MissionJob
    since: float
    future: Future


class DaskExecutor(Executor):
    """Missions on the workers of a scheduler; ``capacity`` follows the workers as they come and go.

    Where a worker dies its mission is run elsewhere. What the lost worker may still send is ignored, since only the
    scheduler's word counts. The ``client`` is closed with this executor, and with it the cluster that was started for it.
    """

    def __init__(self, client: Client, timeout_s: float) -> None:
        super().__init__(timeout_s)
        self._client = client
        self._attempts: dict[str, _Attempt] = {}
        self._rocks: dict[str, tuple[str, Future]] = {}  # hash and content
        self._counted, self._count = -_COUNTED_EVERY_S, 0
        for name in ("distributed", "distributed.client", "asyncio"):
            logging.getLogger(name).setLevel(logging.CRITICAL)  # what matters comes back as an outcome

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

    def submit(self, job: MissionJob) -> None:
        self._require_scheduler()
        job.directory.mkdir(parents=True, exist_ok=True)
        remove_earlier_result(job)
        rock_sha256, rock = self._rock(job)
        order = {
            "job": job.to_dict(),
            "rock_sha256": rock_sha256,
            "timeout_s": self._timeout_s,
            "identity": worker.identity(job),
        }
        # A key of its own: Dask would take an equal mission for the same one.
        future = self._client.submit(
            worker.run_order, order, rock, key=f"{job.id}-{uuid.uuid4().hex}", pure=False
        )
        self._attempts[job.id] = _Attempt(job, time.monotonic(), future)

    def _rock(self, job: MissionJob) -> tuple[str, Future | None]:
        """Return hash and content of a rock that workers cannot make themselves; Dask takes it where it is needed."""
        made_there = job.rock in RECIPES or generated_name(job.rock) is not None
        if made_there or not mission_kind(job.fidelity).uses_catalogue:
            return "", None
        if job.rock not in self._rocks or self._rocks[job.rock][1].status not in ("pending", "finished"):
            rock = load_rock(job.rock, Store())
            path = worker.received_rock(rock.sha256)
            write_rock(rock, path)
            content = self._client.submit(bytes, path.read_bytes(), key=f"rock-{uuid.uuid4().hex}")
            self._rocks[job.rock] = rock.sha256, content
        return self._rocks[job.rock]

    def wait_any(self, timeout_s: float) -> list[Trial]:
        deadline = time.monotonic() + timeout_s
        while not (done := [attempt for attempt in self._attempts.values() if attempt.future.done()]):
            if time.monotonic() > deadline:
                break
            time.sleep(_LOOKED_EVERY_S)
        return [self._trial_of(attempt) for attempt in done]

    def _trial_of(self, attempt: _Attempt) -> Trial:
        answer, reason, message = self._answer(attempt.future)
        job, wall_s = attempt.job, time.monotonic() - attempt.since
        del self._attempts[job.id]
        attempt.future.release()  # a scheduler makes anew what is wanted still where a worker is lost
        trial = None
        if answer is not None:
            reason, message, wall_s = answer["reason"], answer["message"], answer["wall_s"]
            worker.unpack(answer["files"], job.directory)
            trial = load_trial(job, wall_s)
        return trial or job.failed(reason, message, wall_s)

    def _answer(self, future: Future) -> tuple[dict[str, Any] | None, str, str]:
        """Return a worker's answer, or reason and message why there is none."""
        if future.status in ("cancelled", "lost"):
            self._require_scheduler()
            return None, "server_lost", "the way to the scheduler was cut"
        try:
            return future.result(timeout=_RECONNECT_S), "", ""
        except Exception as error:  # whatever the worker, or the way to it, raised
            name = type(error).__name__
            if name in _WORKER_LOST:
                return None, "worker_killed", f"the worker died or left ({name})"
            if isinstance(error, UserError):  # such as a plug-in that is not installed there
                return None, "user_error", f"a worker refuses: {error}"
            if isinstance(error, ImportError):
                return None, "user_error", f"a worker cannot import this program ({error}); install it there"
            return None, "machine_error", f"{name}: {error}"

    def _require_scheduler(self) -> None:
        deadline = time.monotonic() + _RECONNECT_S
        while self._client.status != "running":
            if time.monotonic() > deadline:
                raise UserError("the Dask scheduler is gone; start it again, then resume the campaign")
            time.sleep(0.05)

    def cancel_all(self) -> None:
        attempts, self._attempts = self._attempts, {}
        if attempts and self._client.status == "running":
            with contextlib.suppress(OSError, TimeoutError):
                self._client.cancel([attempt.future for attempt in attempts.values()], force=True)

    def close(self) -> None:
        """Let go of everything; ends a cluster that was started for this executor."""
        self.cancel_all()
        cluster = self._client.cluster
        for end in (self._client.close, *([] if cluster is None else [cluster.close])):
            with contextlib.suppress(OSError, TimeoutError):
                end(timeout=_RECONNECT_S)
