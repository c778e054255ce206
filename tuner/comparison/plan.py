"""What an evaluation runs: named configurations in the same instances with the same replicates, and its directory.

The directory holds ``evaluation.yaml`` and ``missions/STRATEGY/NN_ROCK_rK`` (``NN_ROCK_CONDITION_rK`` where that is not ideal).
"""

from __future__ import annotations

import collections
import dataclasses
import functools
import itertools
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from nbv.config import (
    IDEAL,
    IDEAL_CONDITION,
    Condition,
    MissionConfig,
    condition_from_dict,
    config_from_dict,
    require_distinct,
    under,
)
from nbv.errors import UserError
from nbv.mission.result import Keep
from nbv.safe_files import read_yaml, require, to_yaml, write_atomic
from tuner.missions.job import MissionJob, Trial, load_trial
from tuner.missions.pool import Executor, MissionPool
from tuner.missions.registry import DEFAULT_FIDELITY, FIDELITIES, kind_on, mission_kind
from tuner.missions.run_jobs import JobList, long_run, run_jobs
from tuner.problem.instances import Instance, require_rocks
from tuner.problem.observations import MAX_REPLICATES, mission_key

PLAN_FILE = "evaluation.yaml"
FORMAT_VERSION = 4


@dataclass(frozen=True)
class EvaluationPlan:
    """Named configurations, rocks, conditions and replicates; every combination is one mission.

    Raises `UserError`: nothing to compare.
    """

    strategies: Mapping[str, MissionConfig]
    rocks: tuple[str, ...]
    replicates: int = 1  # numbered from ``first_replicate``, the same for all strategies
    first_replicate: int = 0
    fidelity: str = DEFAULT_FIDELITY
    keep: Keep = "summary"
    conditions: tuple[Condition, ...] = (IDEAL_CONDITION,)

    def __post_init__(self) -> None:
        if not self.strategies:
            raise UserError("no strategy to evaluate; name at least one")
        require_rocks(self.rocks)
        require_distinct(self.conditions)
        FIDELITIES.require(self.fidelity)
        if self.replicates < 1:
            raise UserError(f"replicates is {self.replicates}; give at least 1")
        require(self.replicates, MAX_REPLICATES, "replicates")
        for name in self.strategies:
            if not name or "/" in name or name.startswith("."):
                raise UserError(f"{name!r} cannot name a strategy; use letters, digits and dashes")

    @property
    def missions(self) -> int:
        """Missions in all, strategies that are the same configuration counted once."""
        return len(set(self.owners.values())) * len(self.instances) * self.replicates

    @property
    def instances(self) -> tuple[Instance, ...]:
        """Every rock under every condition, condition by condition."""
        return tuple(Instance(rock, condition.name) for condition in self.conditions for rock in self.rocks)

    @property
    def _replicates(self) -> range:
        return range(self.first_replicate, self.first_replicate + self.replicates)

    def to_dict(self) -> dict[str, Any]:
        return {
            "format": FORMAT_VERSION,
            "rocks": list(self.rocks),
            "replicates": self.replicates,
            "first_replicate": self.first_replicate,
            "fidelity": self.fidelity,
            "keep": self.keep,
            "conditions": {condition.name: condition.to_dict() for condition in self.conditions},
            "strategies": {name: config.to_dict() for name, config in self.strategies.items()},
        }

    @staticmethod
    def load(directory: Path) -> EvaluationPlan:
        """The plan of an evaluation's directory; ``UserError`` if there is none."""
        path = directory / PLAN_FILE
        if not path.is_file():
            raise UserError(f"{directory} holds no evaluation ({PLAN_FILE} is missing)")
        try:
            tree = read_yaml(path)
            if tree["format"] != FORMAT_VERSION:
                raise UserError(
                    f"{path} has format {tree['format']}, this version reads {FORMAT_VERSION}; begin it again in another directory"
                )
            return EvaluationPlan(
                {name: config_from_dict(config) for name, config in tree["strategies"].items()},
                tuple(tree["rocks"]),
                tree["replicates"],
                tree["first_replicate"],
                tree["fidelity"],
                tree["keep"],
                tuple(
                    condition_from_dict(name, content, str(path))
                    for name, content in tree["conditions"].items()
                ),
            )
        except (KeyError, TypeError, AttributeError) as error:
            raise UserError(f"{path} is not an evaluation's plan ({error!r}); restore the file") from error
        except UserError as error:  # such as a plug-in that is not installed
            raise UserError(f"{path}: {error}") from error

    def require_runnable(self) -> None:
        """Raise `UserError` where a strategy cannot fly under a condition, or a photograph set cannot give what it asks for."""
        for (name, config), condition in itertools.product(self.strategies.items(), self.conditions):
            try:
                varied = config if condition.name == IDEAL else under(config, condition)
                varied.require_flyable()
                for kind in (kind_on(rock, self.fidelity) for rock in self.rocks):
                    kind.require_possible(varied)
            except UserError as error:
                raise UserError(f"strategy {name} cannot run under {condition.name}: {error}") from error

    def jobs(self, directory: Path) -> list[MissionJob]:
        """One job per distinct mission: replicates outermost, so that partial results are balanced.

        Instances innermost: workers on one target would each make again what the other is making.
        """
        owners = dict.fromkeys(self.owners.values())
        return [
            self._job(directory, name, instance, k)
            for k, name, instance in itertools.product(self._replicates, owners, self.instances)
        ]

    @functools.cached_property
    def owners(self) -> dict[str, str]:
        """By strategy the one whose missions count for it: the first that runs the same."""
        first: dict[str, str] = {}
        return {name: first.setdefault(mission_key(c), name) for name, c in self.strategies.items()}

    def _job(self, directory: Path, strategy: str, instance: Instance, replicate: int) -> MissionJob:
        condition = next(c for c in self.conditions if c.name == instance.condition)
        owner = self.owners[strategy]
        config = self.strategies[owner]  # of the same mission, whatever else differs
        folder = f"{self.rocks.index(instance.rock):02d}_{instance.file_name}_r{replicate}"
        return MissionJob(
            f"{owner}/{folder}",
            config if condition.name == IDEAL else under(config, condition),
            instance.rock,
            replicate,
            directory / "missions" / owner / folder,
            self.keep,
            self.fidelity,
        )

    def records(self, directory: Path) -> list[Trial]:
        """What is known of every combination so far; missions not run yet are left out."""
        records = []
        for name, instance, k in itertools.product(self.strategies, self.instances, self._replicates):
            trial = load_trial(self._job(directory, name, instance, k))
            if trial is not None and not trial.infrastructure_failure:
                records.append(dataclasses.replace(trial, strategy=name))
        return records


# Running an evaluation: a mission that has finished is never run again, so an interrupted one goes on where it stopped.


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
    if _holds_another(plan, directory):
        raise UserError(f"{directory} holds another evaluation; name another directory with --out")
    if not (directory / PLAN_FILE).exists():
        if directory.exists() and (not directory.is_dir() or any(directory.iterdir())):
            raise UserError(f"{directory} exists and is not an empty directory; choose another directory")
        try:
            directory.mkdir(parents=True, exist_ok=True)
            write_atomic(directory / PLAN_FILE, to_yaml(plan.to_dict()))
        except OSError as error:
            why = f"cannot write to {directory}: {error.strerror}; choose another directory"
            raise UserError(why) from error
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
