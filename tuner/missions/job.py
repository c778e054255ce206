"""A mission as the tuner sees it: a job that goes to a worker, and the outcome that comes back."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from nbv.checksums import require_checksum
from nbv.errors import UserError
from nbv.mission.function import Keep
from nbv.mission.run_directory import write_atomic
from nbv.safe_files import RESULT_BYTES, RESULT_NODES, read_json
from tuner.missions.external.configuration import configuration_from_dict
from tuner.missions.registry import DEFAULT_FIDELITY
from tuner.problem.search_space import Configuration

RESULT_FILE = "mission.json"
ERROR_FILE = "worker_error.json"
LOG_FILE = "worker.log"
_INFRASTRUCTURE_FAILURES = {
    "disk_full",
    "machine_error",
    "not_started",
    "output_not_writable",
    "server_lost",
    "worker_killed",
    "worker_stopped",
}
_POSSIBLY_MACHINE_FAULTS = {"out_of_memory", "worker_died"}


@dataclass(frozen=True)
class MissionJob:
    """One mission to fly."""

    id: str  # unique among the jobs of one executor
    config: Configuration
    rock: str
    replicate: int
    directory: Path
    keep: Keep = "summary"
    fidelity: str = DEFAULT_FIDELITY  # a name of the registry, or module:function

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON form for a worker."""
        return {
            "id": self.id,
            "config": self.config.to_dict(),
            "rock": self.rock,
            "replicate": self.replicate,
            "directory": str(self.directory),
            "keep": self.keep,
            "fidelity": self.fidelity,
        }

    @staticmethod
    def from_dict(tree: Mapping[str, Any]) -> MissionJob:
        """The inverse of ``to_dict``."""
        fields = {
            **tree,
            "config": configuration_from_dict(tree["config"]),
            "directory": Path(tree["directory"]),
        }
        return MissionJob(**fields)


@dataclass(frozen=True)
class MissionOutcome:
    """How a job ended. ``metrics`` is empty when ``status`` is ``failed``."""

    job_id: str
    status: Literal["ok", "degraded", "failed"]
    reason: str = ""  # snake_case code, e.g. "worker_died: signal 6", "timeout", "seed_model_failed"
    message: str = ""
    metrics: dict[str, Any] = field(default_factory=dict)
    costs: dict[str, Any] = field(default_factory=dict)
    timings_s: dict[str, Any] = field(default_factory=dict)
    wall_s: float = 0.0
    directory: str = ""
    rock_sha256: str = ""  # of the rock that was flown, where the mission says so

    @property
    def infrastructure_failure(self) -> bool:
        """Whether the machine ended it: this says nothing about the configuration, and the mission may be flown again."""
        return self.status == "failed" and self.reason.partition(":")[0] in _INFRASTRUCTURE_FAILURES

    @property
    def possibly_machine_fault(self) -> bool:
        """Whether the machine or the configuration may have ended it."""
        return self.status == "failed" and self.reason.partition(":")[0] in _POSSIBLY_MACHINE_FAULTS

    def should_retry(self, attempt: int, max_attempts: int, *, excused: bool) -> bool:
        """Return whether to fly the mission once more after this ``attempt`` (from 1).

        An infrastructure failure is retried until ``max_attempts``; a possible machine fault once only: where an earlier
        attempt was ``excused`` as one, the fault is the configuration's.
        """
        if self.infrastructure_failure:
            return attempt < max_attempts
        return self.possibly_machine_fault and not excused and max_attempts > 1


def collect_outcome(job: MissionJob, wall_s: float | None = None) -> MissionOutcome | None:
    """Return the outcome that a worker left in the job's directory; None when the mission did not finish.

    A ``mission.json`` of another configuration, condition, rock or replicate is not this mission's, nor one that was changed
    since it was written.
    """
    tree = _read_json(job.directory / RESULT_FILE)
    if tree is not None and _is_of(tree, job):
        costs = tree.get("costs") or {}
        return MissionOutcome(
            job.id,
            tree.get("status", "failed"),
            tree.get("reason") or "",
            tree.get("message") or "",
            tree.get("metrics") or {},
            costs,
            tree.get("timings_s") or {},
            float(wall_s if wall_s is not None else costs.get("wall_s") or 0.0),
            str(job.directory),
            str((tree.get("provenance") or {}).get("rock_sha256") or ""),
        )
    tree = _read_json(job.directory / ERROR_FILE)
    if tree is not None and tree.get("job_id") == job.id:
        return failed_outcome(job, tree["reason"], tree["message"], wall_s or 0.0)
    return None


def failed_outcome(job: MissionJob, reason: str, message: str, wall_s: float = 0.0) -> MissionOutcome:
    """Return the outcome of a mission that ended without metrics.

    Parameters
    ----------
    job
        The mission.
    reason
        The reason as a word for programs, such as ``timeout``.
    message
        The reason for people, in one line.
    wall_s
        How long the mission took.
    """
    return MissionOutcome(job.id, "failed", reason, message, wall_s=wall_s, directory=str(job.directory))


def record_failure(job: MissionJob, reason: str, message: str) -> None:
    """Leave the reason of a failure in the job's directory; ``OSError`` if that cannot be written."""
    text = json.dumps({"job_id": job.id, "reason": reason, "message": message})
    write_atomic(job.directory / ERROR_FILE, text)


def clear_traces(job: MissionJob) -> None:
    """Remove what an earlier, unfinished attempt at this job may have left as its result."""
    for name in (RESULT_FILE, ERROR_FILE):
        (job.directory / name).unlink(missing_ok=True)


def _is_of(tree: Mapping[str, Any], job: MissionJob) -> bool:
    if (tree.get("config_digest"), tree.get("replicate")) != (job.config.digest(), job.replicate):
        return False
    condition = getattr(job.config, "condition", None)
    if condition is not None and tree.get("condition", condition) != condition:
        return False
    # A mesh file's rock has a name of its own: its content is compared by the campaign.
    is_name = os.sep not in job.rock and not Path(job.rock).suffix
    return not is_name or tree.get("rock", job.rock) == job.rock


def _read_json(path: Path) -> dict[str, Any] | None:
    try:
        tree = read_json(path, RESULT_BYTES, RESULT_NODES)
        require_checksum(tree, str(path))
    except UserError:
        return None
    return tree if isinstance(tree, dict) else None
