"""A mission as the tuner sees it: a job that goes to a worker, and the trial that comes of it."""

from __future__ import annotations

import contextlib
import dataclasses
import datetime
import functools
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from nbv import plugins
from nbv.config import MissionConfig, config_from_dict
from nbv.errors import UserError
from nbv.mission.result import Keep, MissionResult
from nbv.mission.run_directory import RESULT, read_result
from nbv.safe_files import remove, write_atomic
from tuner.missions.registry import DEFAULT_FIDELITY
from tuner.problem.goal import Objective
from tuner.problem.instances import Instance
from tuner.problem.observations import Observation, photographs_key

MAX_ATTEMPTS = 3  # of one mission that the machine keeps ending
_INFRASTRUCTURE_FAILURES = {
    "disk_full",
    "machine_error",
    "not_started",
    "output_not_writable",
    "server_lost",
    "worker_lost",
}
_POSSIBLY_MACHINE_FAULTS = {"out_of_memory", "worker_died"}
_MEASURED = ("metrics", "costs")  # what of a mission.json is kept in memory


@dataclass(frozen=True)
class MissionJob:
    """One mission to run."""

    id: str  # unique among the jobs of one executor
    config: MissionConfig
    rock: str
    replicate: int
    directory: Path
    keep: Keep = "summary"
    fidelity: str = DEFAULT_FIDELITY

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON form for a worker, which imports the plug-ins that were named to this process."""
        return {
            **vars(self),
            "config": self.config.to_dict(),
            "directory": str(self.directory.absolute()),
            "plugins": plugins.plugin_specs(),
            "identity": {"config_digest": self.config.digest(), "condition": self.config.condition},
        }

    @staticmethod
    def from_dict(tree: Mapping[str, Any]) -> MissionJob:
        """The inverse of ``to_dict``."""
        for spec in tree["plugins"]:
            plugins.use(spec)
        fields = {field.name: tree[field.name] for field in dataclasses.fields(MissionJob)}
        config, directory = config_from_dict(tree["config"]), Path(tree["directory"])
        return MissionJob(**{**fields, "config": config, "directory": directory})

    def trial(self, *, reason: str = "", **ended: Any) -> Trial:
        """Return the trial of this job whose record says that it ``ended`` so; ``reason``: why it failed."""
        return Trial(
            rock=self.rock,
            replicate=self.replicate,
            condition=self.config.condition,
            reason=reason,
            record=Record(
                directory=self.directory, config_digest=self.config.digest(), job_id=self.id, **ended
            ),
        )

    def failed(self, reason: str, message: str, wall_s: float = 0.0) -> Trial:
        """Return the failed trial of a mission without a result; ``reason``: a code such as ``timeout``, ``message``: for people."""
        return self.trial(status="failed", reason=reason, message=message, wall_s=wall_s)


@dataclass(frozen=True, kw_only=True)
class Record:
    """What ran, when, where, how long and how it ended: nothing learns from it."""

    status: Literal["", "ok", "degraded", "failed"] = ""  # empty while it is in flight
    message: str = ""
    wall_s: float = 0.0
    directory: Path = Path()  # of the mission
    job_id: str = ""
    config_digest: str = ""
    rock_sha256: str = ""  # of the rock that was run, where the mission says so
    photographs: str = ""  # `photographs_key`
    switched: bool | None = None  # whether its views are of more than one scorer; None where none was planned
    # In a campaign:
    metadata: Mapping[str, Any] = field(default_factory=dict)  # of its proposal: sampler, phase, ...
    code: str = ""  # digest of what runs it, see `tuner.campaign.session.ReproducibilityCheck`
    started: datetime.datetime | None = None
    finished: datetime.datetime | None = None
    # What its mission.json has, where that was read.
    measured: Mapping[str, Any] | None = field(default=None, repr=False, compare=False)


@dataclass(frozen=True, kw_only=True)
class Trial(Observation):
    """One mission, of a campaign or an evaluation: an observation, which samplers and the surrogate know, and its record.

    What a mission measured is in its ``mission.json`` alone, and read when it is asked for.
    """

    number: int = 0  # in a campaign
    values: Mapping[str, Any] = field(default_factory=dict)  # tuned parameters
    strategy: str = ""  # in an evaluation
    record: Record = Record()

    def __repr__(self) -> str:
        """``Trial(12: ok on slab r1)``, in an evaluation ``Trial(tuned: ok on slab r1)``."""
        which, status = self.strategy or self.number, self.record.status or "running"
        return f"Trial({which}: {status} on {self.instance.label} r{self.replicate})"

    @property
    def state(self) -> Literal["running", "complete", "failed"]:
        """``failed`` also without the objective's metric."""
        if not self.record.status:
            return "running"
        return "failed" if self.raw is None else "complete"

    @property
    def photographs_taken(self) -> tuple[Instance, int, str, float | None]:
        """Equal for trials that took the same photographs in one instance and replicate, and so had the same outcome."""
        return self.instance, self.replicate, self.record.photographs, self.raw

    @functools.cached_property
    def _document(self) -> Mapping[str, Any]:
        """What ``mission.json`` says was measured; nothing where it is gone."""
        if self.record.measured is not None:
            return self.record.measured
        tree = _result_in(self.record.directory) if self.record.status else None
        return {key: tree.get(key) or {} for key in _MEASURED} if tree else {}

    @property
    def metrics(self) -> Mapping[str, Any]:
        return self._document.get("metrics", {})

    @property
    def costs(self) -> Mapping[str, Any]:
        return self._document.get("costs", {})

    @property
    def measurements(self) -> dict[str, Any]:
        """What objectives are looked for in."""
        return {**self.metrics, "costs": self.costs}

    def measured(self, objective: Objective) -> float | None:
        """An objective's metric, perhaps another than the campaign's; None while running, where it failed or has none."""
        if self.record.status in ("", "failed"):
            return None
        return objective.measure(self.measurements)

    def value(self, key: str) -> float | None:
        """A metric by path, or a cost by ``costs.NAME``; None where the mission has none."""
        return self.measured(Objective(key))

    @property
    def infrastructure_failure(self) -> bool:
        """Whether the machine ended it: this says nothing about the configuration, and the mission may be run again."""
        return self.record.status == "failed" and self.reason.partition(":")[0] in _INFRASTRUCTURE_FAILURES

    @property
    def is_final(self) -> bool:
        """Whether it has ended, neither by the machine nor by a user's mistake: it is not run again."""
        return self.reason != "user_error" and not self.infrastructure_failure

    @property
    def possibly_machine_fault(self) -> bool:
        """Whether the machine or the configuration may have ended it."""
        return self.record.status == "failed" and self.reason.partition(":")[0] in _POSSIBLY_MACHINE_FAULTS


def should_retry(attempts: Sequence[Trial]) -> bool:
    """Return whether to run a mission once more; after a possible machine fault once only: a second one is the configuration's."""
    *earlier, last = attempts
    if last.infrastructure_failure:
        return len(attempts) < MAX_ATTEMPTS
    return last.possibly_machine_fault and not any(trial.possibly_machine_fault for trial in earlier)


def load_trial(job: MissionJob, wall_s: float | None = None) -> Trial | None:
    """Return how a job ended, as its directory tells; None when the mission did not finish.

    A ``mission.json`` of another configuration, condition, rock or replicate is not this mission's.
    """
    expected = {
        "config_digest": job.config.digest(),
        "replicate": job.replicate,
        "condition": job.config.condition,
    }
    # A mesh file's rock has a name of its own: its content is compared by the campaign.
    if os.sep not in job.rock and not Path(job.rock).suffix:
        expected["rock"] = job.rock
    tree = _result_in(job.directory)
    if tree is None or any(tree.get(key) != value for key, value in expected.items()):
        return None
    if not all(isinstance(tree.get(key) or {}, dict) for key in ("provenance", "costs", *_MEASURED)):
        return None
    scorers = {step.get("scorer") for step in tree.get("trace") or ()}
    chosen = [str(step.get("chosen")) for step in tree.get("trace") or ()]
    return job.trial(
        status=tree.get("status", "failed"),
        reason=tree.get("reason") or "",
        message=tree.get("message") or "",
        wall_s=float(wall_s if wall_s is not None else (tree.get("costs") or {}).get("wall_s") or 0.0),
        rock_sha256=str((tree.get("provenance") or {}).get("rock_sha256") or ""),
        photographs="" if tree.get("status") == "failed" else photographs_key(job.config, chosen),
        switched=len(scorers) > 1 if scorers else None,
        measured={key: tree.get(key) or {} for key in _MEASURED},
    )


def repeated(trials: Iterable[Trial]) -> set[int]:
    """Return the numbers of those trials whose photographs an earlier one has taken in the same instance and replicate."""
    first: dict[tuple[Instance, int, str, float | None], int] = {}
    taken = [t for t in trials if t.record.photographs]
    return {t.number for t in taken if first.setdefault(t.photographs_taken, t.number) != t.number}


def record_failure(tree: Mapping[str, Any], reason: str, message: str) -> None:
    """Leave the ``mission.json`` of a mission that left none itself; ``OSError`` if that cannot be written.

    ``tree``: its `MissionJob.to_dict`.
    """
    result = MissionResult(
        status="failed",
        reason=reason,
        message=message,
        rock=tree["rock"],
        replicate=tree["replicate"],
        metrics={},
        trace=[],
        timings_s={},
        costs={},
        **tree["identity"],
    )
    directory = Path(tree["directory"])
    directory.mkdir(parents=True, exist_ok=True)
    write_atomic(directory / RESULT, result.to_json())


def remove_earlier_result(job: MissionJob) -> None:
    """Remove the result that an earlier, unfinished attempt at this job may have left."""
    remove(job.directory / RESULT)


def _result_in(directory: Path) -> dict[str, Any] | None:
    with contextlib.suppress(UserError):
        return read_result(directory)
    return None
