"""Running an evaluation: a mission that has finished is never run again, so an interrupted one goes on where it stopped."""

from __future__ import annotations

import collections
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from nbv.errors import UserError
from nbv.safe_files import to_yaml, write_atomic
from tuner.comparison.plan import PLAN_FILE, EvaluationPlan
from tuner.missions.job import MissionJob, Trial
from tuner.missions.long_runs import long_run
from tuner.missions.pool import Executor, MissionPool
from tuner.missions.registry import mission_kind
from tuner.missions.run_jobs import JobList, run_jobs


@dataclass(frozen=True)
class EvaluationEvent:
    """A mission was launched, or has ended."""

    job: MissionJob
    trial: Trial | None  # how it ended; None: launched
    finished: int  # missions that have ended, those of earlier sessions included
    total: int


@dataclass(frozen=True)
class EvaluationRun:
    """What ``run_evaluation`` leaves: all records, and whether they are complete."""

    plan: EvaluationPlan
    records: list[Trial]
    complete: bool
    elapsed_s: float
    directory: Path

    def __repr__(self) -> str:
        """``EvaluationRun(tuned, hyb-h on arch, fin: 24 missions, 0 failed, complete)``."""
        failed = sum(trial.record.status == "failed" for trial in self.records)
        return (
            f"EvaluationRun({', '.join(self.plan.strategies)} on {', '.join(self.plan.rocks)}: "
            f"{len(self.records)} missions, {failed} failed, {'complete' if self.complete else 'incomplete'})"
        )

    @property
    def failures(self) -> dict[str, int]:
        """Failed missions by reason."""
        return dict(collections.Counter(r.reason for r in self.records if r.record.status == "failed"))


def run_evaluation(
    plan: EvaluationPlan,
    directory: Path,
    executor: Executor,
    on_event: Callable[[EvaluationEvent], None] | None = None,
) -> EvaluationRun:
    """Run what is not run yet, until done, Ctrl-C or SIGTERM.

    Missions that the machine ended (`Trial.infrastructure_failure`) leave no record, and the evaluation incomplete.

    Raises `UserError`: a strategy cannot run; the directory holds something else or cannot be written; a mission met a user's mistake.
    """
    plan.require_runnable()
    began = time.monotonic()
    jobs = {job.id: job for job in plan.jobs(directory)}

    def tell(job: MissionJob, trial: Trial | None = None) -> None:
        if on_event is not None:
            on_event(EvaluationEvent(job, trial, len(jobs) - evaluated.open, len(jobs)))

    evaluated = JobList(jobs.values(), tell, lambda trial: tell(jobs[trial.record.job_id], trial))
    if evaluated.open and isinstance(executor, MissionPool):
        for config in plan.strategies.values():
            mission_kind(plan.fidelity).require_dense_stage(config)
    _claim(plan, directory)
    with long_run(directory) as stop:
        run_jobs(evaluated, executor, stop)
    elapsed_s = time.monotonic() - began
    return EvaluationRun(plan, plan.records(directory), not evaluated.open, elapsed_s, directory)


def evaluation_directory(plan: EvaluationPlan, usual: Path) -> Path:
    """``usual``, or ``usual-2`` and so on: the first that holds this plan or nothing yet.

    A campaign goes on and recommends something else, other rocks are asked for: what was run before stays.
    """
    directory, number = usual, 1
    while _holds_another(plan, directory):
        number += 1
        directory = usual.with_name(f"{usual.name}-{number}")
    return directory


def _holds_another(plan: EvaluationPlan, directory: Path) -> bool:
    return (directory / PLAN_FILE).exists() and EvaluationPlan.load(directory).to_dict() != plan.to_dict()


def _claim(plan: EvaluationPlan, directory: Path) -> None:
    if _holds_another(plan, directory):
        raise UserError(f"{directory} holds another evaluation; name another directory with --out")
    if (directory / PLAN_FILE).exists():
        return
    if directory.exists() and (not directory.is_dir() or any(directory.iterdir())):
        raise UserError(f"{directory} exists and is not an empty directory; choose another directory")
    try:
        directory.mkdir(parents=True, exist_ok=True)
        write_atomic(directory / PLAN_FILE, to_yaml(plan.to_dict()))
    except OSError as error:
        raise UserError(f"cannot write to {directory}: {error.strerror}; choose another directory") from error
