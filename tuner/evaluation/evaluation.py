"""Fixed configurations against each other: the same rocks and replicates for all, then the statistics.

Used by ``gatetune evaluate`` (tuned against baselines on held-out rocks) and ``gatetune reproduce``. The
directory holds ``evaluation.yaml`` and ``missions/STRATEGY/ROCK_rK``; a mission that has finished is never
flown again, so an interrupted evaluation goes on where it stopped.
"""

from __future__ import annotations

import collections
import functools
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import yaml

from nbv.config import MissionConfig, config_from_dict
from nbv.errors import UserError
from nbv.mission.run_directory import write_atomic
from nbv.mission.runner import Keep
from tuner.evaluation.paper_table import TABLE_I_ROWS, MetricRow
from tuner.evaluation.statistics import Interval, Method, PairedDifference, mean_interval, paired_difference
from tuner.missions.executors import Executor
from tuner.missions.job import MissionJob, MissionOutcome, collect_outcome
from tuner.missions.long_runs import exclusive, stop_signals
from tuner.missions.registry import DEFAULT_RUNNER
from tuner.problem.objective import Objective

PLAN_FILE = "evaluation.yaml"
FORMAT_VERSION = 2  # 1 named its runner by module and function
_POLL_S = 0.5


@dataclass(frozen=True)
class EvaluationPlan:
    """Named configurations, rocks and replicates; every combination is one mission.

    Raises
    ------
    UserError
        Nothing to compare.
    """

    strategies: dict[str, MissionConfig]
    rocks: tuple[str, ...]
    replicates: int = 1  # numbered from ``first_replicate``, the same for all strategies
    first_replicate: int = 0
    runner: str = DEFAULT_RUNNER
    keep: Keep = "summary"

    def __post_init__(self) -> None:
        if not self.strategies:
            raise UserError("no strategy to evaluate; name at least one")
        if not self.rocks:
            raise UserError("no rock to evaluate on; name at least one")
        if len(set(self.rocks)) != len(self.rocks):
            twice = next(rock for rock, n in collections.Counter(self.rocks).items() if n > 1)
            raise UserError(f"rock {twice!r} is named twice; name each rock once")
        if self.replicates < 1:
            raise UserError(f"replicates is {self.replicates}; give at least 1")
        for name in self.strategies:
            if not name or "/" in name or name.startswith("."):
                raise UserError(f"{name!r} cannot name a strategy; use letters, digits and dashes")

    @property
    def missions(self) -> int:
        """Missions in all, strategies that are the same configuration counted once."""
        return len(set(self._owners.values())) * len(self.rocks) * self.replicates

    def to_dict(self) -> dict[str, Any]:
        """YAML form."""
        return {
            "format": FORMAT_VERSION,
            "rocks": list(self.rocks),
            "replicates": self.replicates,
            "first_replicate": self.first_replicate,
            "runner": self.runner,
            "keep": self.keep,
            "strategies": {name: config.to_dict() for name, config in self.strategies.items()},
        }

    @staticmethod
    def load(directory: Path) -> EvaluationPlan:
        """The plan of an evaluation's directory; ``UserError`` if there is none."""
        path = directory / PLAN_FILE
        if not path.is_file():
            raise UserError(f"{directory} holds no evaluation ({PLAN_FILE} is missing)")
        try:
            tree = yaml.safe_load(path.read_text())
            if tree["format"] != FORMAT_VERSION:
                raise UserError(
                    f"{path} has format {tree['format']}, this version reads {FORMAT_VERSION}; begin it again in another directory"
                )
            return EvaluationPlan(
                {name: config_from_dict(config) for name, config in tree["strategies"].items()},
                tuple(tree["rocks"]), tree["replicates"], tree["first_replicate"], tree["runner"], tree["keep"],
            )  # fmt: skip
        except (OSError, yaml.YAMLError, KeyError, TypeError, AttributeError) as error:
            raise UserError(f"{path} is not an evaluation's plan ({error!r}); restore the file") from error

    def jobs(self, directory: Path) -> list[MissionJob]:
        """One job per distinct mission: replicates outermost, so that partial results are balanced."""
        jobs = []
        for k in range(self.first_replicate, self.first_replicate + self.replicates):
            for rock in self.rocks:
                jobs += [self._job(directory, name, rock, k)
                         for name, owner in self._owners.items() if name == owner]  # fmt: skip
        return jobs

    @functools.cached_property
    def _owners(self) -> dict[str, str]:
        """Strategies that are one and the same configuration share the first one's missions."""
        first: dict[str, str] = {}
        return {name: first.setdefault(c.digest(), name) for name, c in self.strategies.items()}

    def _job(self, directory: Path, strategy: str, rock: str, replicate: int) -> MissionJob:
        config = self.strategies[strategy]
        owner = self._owners[strategy]
        rock_index = self.rocks.index(rock)
        folder = f"{rock_index:02d}_{Path(rock).stem}_r{replicate}"
        return MissionJob(
            f"{owner}/{folder}", config, rock, replicate, directory / "missions" / owner / folder, self.keep,
            self.runner,
        )  # fmt: skip

    def records(self, directory: Path) -> list[EvaluationRecord]:
        """What is known of every combination so far; missions not flown yet are left out."""
        records = []
        for name in self.strategies:
            for rock in self.rocks:
                for k in range(self.first_replicate, self.first_replicate + self.replicates):
                    outcome = collect_outcome(self._job(directory, name, rock, k))
                    if outcome is not None:
                        records.append(EvaluationRecord(name, rock, k, outcome))
        return records


@dataclass(frozen=True)
class EvaluationRecord:
    """One strategy's mission on one rock with one replicate."""

    strategy: str
    rock: str
    replicate: int
    outcome: MissionOutcome

    def value(self, key: str) -> float | None:
        """A metric by path, or a cost by ``costs.NAME``; None where the mission has none."""
        tree: Mapping[str, Any] = {**self.outcome.metrics, "costs": self.outcome.costs}
        if self.outcome.status == "failed":
            return None
        return Objective(key).measure(tree)


@dataclass(frozen=True)
class EvaluationEvent:
    """Something a live display may show."""

    kind: Literal["launched", "finished", "failed", "interrupted", "done"]
    elapsed_s: float
    finished: int  # missions with an outcome, those of earlier sessions included
    total: int
    job: MissionJob | None = None
    outcome: MissionOutcome | None = None


@dataclass(frozen=True)
class EvaluationRun:
    """What ``run_evaluation`` leaves: all records, and whether they are complete."""

    plan: EvaluationPlan
    records: list[EvaluationRecord]
    complete: bool
    elapsed_s: float
    failures: dict[str, int] = field(default_factory=dict)  # by reason


def run_evaluation(
    plan: EvaluationPlan,
    directory: Path,
    executor: Executor,
    on_event: Callable[[EvaluationEvent], None] | None = None,
) -> EvaluationRun:
    """Fly what is not flown yet, until done, Ctrl-C or SIGTERM.

    Raises
    ------
    UserError
        The directory holds something else or cannot be written; a mission met a user's mistake.
    """
    _claim(plan, directory)
    emit = on_event or (lambda event: None)
    began = time.monotonic()
    jobs = plan.jobs(directory)
    waiting = collections.deque(job for job in jobs if _unfinished(job))
    flying: dict[str, MissionJob] = {}

    def tell(kind: Any, job: MissionJob | None = None, outcome: MissionOutcome | None = None) -> None:
        finished = len(jobs) - len(waiting) - len(flying)
        emit(EvaluationEvent(kind, time.monotonic() - began, finished, len(jobs), job, outcome))

    try:
        with exclusive(directory), stop_signals() as stop:
            try:
                while (waiting or flying) and not stop.is_set():
                    while waiting and len(flying) < executor.capacity:
                        job = waiting.popleft()
                        flying[job.id] = job
                        executor.submit(job)
                        tell("launched", job)
                    for outcome in executor.wait_any(_POLL_S):
                        job = flying.pop(outcome.job_id)
                        if outcome.reason == "user_error":
                            raise UserError(outcome.message)
                        tell("failed" if outcome.status == "failed" else "finished", job, outcome)
                complete = not waiting and not flying
                tell("done" if complete else "interrupted")
            finally:
                executor.cancel_all()
    except OSError as error:
        raise UserError(
            f"cannot write to {directory}: {error.strerror or error}; make room, then resume"
        ) from error
    records = plan.records(directory)
    return EvaluationRun(plan, records, complete, time.monotonic() - began, failure_counts(records))


def failure_counts(records: Iterable[EvaluationRecord]) -> dict[str, int]:
    """Failed missions by reason."""
    return dict(collections.Counter(r.outcome.reason for r in records if r.outcome.status == "failed"))


def _unfinished(job: MissionJob) -> bool:
    outcome = collect_outcome(job)
    return outcome is None or outcome.reason == "user_error"


def _claim(plan: EvaluationPlan, directory: Path) -> None:
    if (directory / PLAN_FILE).exists():
        if EvaluationPlan.load(directory).to_dict() != plan.to_dict():
            raise UserError(f"{directory} holds another evaluation; choose another directory")
        return
    if directory.exists() and (not directory.is_dir() or any(directory.iterdir())):
        raise UserError(f"{directory} exists and is not an empty directory; choose another directory")
    try:
        directory.mkdir(parents=True, exist_ok=True)
        write_atomic(directory / PLAN_FILE, yaml.safe_dump(plan.to_dict(), sort_keys=False))
    except OSError as error:
        raise UserError(f"cannot write to {directory}: {error.strerror}; choose another directory") from error


# -- statistics ----------------------------------------------------------------------------------------------


def values_of(records: Sequence[EvaluationRecord], strategy: str, key: str) -> dict[tuple[str, int], float]:
    """A metric by (rock, replicate), failed missions left out."""
    found = {}
    for r in records:
        value = r.value(key) if r.strategy == strategy else None
        if value is not None:
            found[r.rock, r.replicate] = value
    return found


def strategy_interval(
    records: Sequence[EvaluationRecord], strategy: str, key: str, method: Method = "auto"
) -> Interval | None:
    """Mean over rocks with its interval."""
    by_rock: dict[str, list[float]] = {}
    for (rock, _), value in values_of(records, strategy, key).items():
        by_rock.setdefault(rock, []).append(value)
    return mean_interval(by_rock, method)


def strategy_difference(
    records: Sequence[EvaluationRecord],
    strategy: str,
    reference: str,
    row: MetricRow,
    method: Method = "auto",
) -> PairedDifference | None:
    """Paired difference of a metric against ``reference`` on common (rock, replicate) pairs."""
    ours, theirs = (values_of(records, name, row.key) for name in (strategy, reference))
    return paired_difference(ours, theirs, row.higher_is_better, method)


def rock_floor(records: Sequence[EvaluationRecord], metric: MetricRow) -> float | None:
    """Mean over rocks of what a perfect reconstruction would get (``nbv.evaluation.floor``).

    A property of the rocks, so missions of all strategies may tell it. None where no mission holds it.
    """
    by_rock: dict[str, float] = {}
    for r in records:
        value = r.value(metric.floor_key)
        if value is not None:
            by_rock[r.rock] = value
    return sum(by_rock.values()) / len(by_rock) if by_rock else None


@dataclass(frozen=True)
class ComparisonRow:
    """One metric across the strategies."""

    metric: MetricRow
    cells: dict[str, Interval | None]  # by strategy
    best: tuple[str, ...]  # strategies with the best mean (several when equal)
    floor: float | None  # what a perfect reconstruction would get, mean over rocks; None for most metrics
    differences: dict[str, PairedDifference | None]  # against the reference, which is left out


@dataclass(frozen=True)
class ComparisonTable:
    """A table in the layout of the paper's Table I, with intervals and paired differences."""

    strategies: tuple[str, ...]
    reference: str | None
    rows: list[ComparisonRow]
    missions: dict[str, int]  # with metrics, by strategy
    failures: dict[str, int]  # failed missions, by strategy


def comparison_table(
    records: Sequence[EvaluationRecord],
    strategies: Sequence[str],
    reference: str | None = None,
    surface: Literal["whole", "observable"] = "whole",
    rows: Sequence[MetricRow] = TABLE_I_ROWS,
    method: Method = "auto",
) -> ComparisonTable:
    """Means with intervals per strategy, and differences against ``reference`` (one of the strategies).

    Raises
    ------
    UserError
        The reference is none of the strategies.
    """
    if reference is not None and reference not in strategies:
        raise UserError(f"reference {reference!r} was not evaluated; choose from {', '.join(strategies)}")
    table = []
    for row in rows:
        metric = row if row.key.startswith("costs.") else row.on(surface)
        cells = {name: strategy_interval(records, name, metric.key, method) for name in strategies}
        means = {name: cell.mean for name, cell in cells.items() if cell is not None}
        pick = max if metric.higher_is_better else min
        best = tuple(name for name, mean in means.items() if mean == pick(means.values())) if means else ()
        differences = {
            name: strategy_difference(records, name, reference, metric, method)
            for name in strategies
            if reference is not None and name != reference
        }
        table.append(ComparisonRow(metric, cells, best, rock_floor(records, metric), differences))
    counts = collections.Counter(r.strategy for r in records if r.outcome.status != "failed")
    failures = collections.Counter(r.strategy for r in records if r.outcome.status == "failed")
    return ComparisonTable(
        tuple(strategies), reference, table,
        {name: counts[name] for name in strategies}, {name: failures[name] for name in strategies},
    )  # fmt: skip
