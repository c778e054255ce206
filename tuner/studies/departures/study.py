"""What each departure of the authors' public code (and each option of ours) does to the outcome, one at a time.

Every arm is the base configuration with one departure, flown on the same rocks and replicates as the base. A
departure that only changes how a cloud is measured is read from the base's own missions: no flight. The run
directory::

    departures.yaml    what was asked for; the same command with the same settings goes on
    missions of the arms, laid out as an evaluation's, under evaluation/
    departures.json  departures.md  figures/
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from nbv.config import MissionConfig, preset
from nbv.errors import UserError
from tuner.evaluation.baselines import baseline
from tuner.evaluation.comparison import values_of
from tuner.evaluation.flying import EvaluationEvent, failure_counts, run_evaluation
from tuner.evaluation.paper_table import MetricRow
from tuner.evaluation.plan import EvaluationPlan, EvaluationRecord
from tuner.evaluation.statistics import Interval, PairedDifference, mean_interval, paired_difference
from tuner.missions.executors import Executor
from tuner.missions.registry import DEFAULT_RUNNER
from tuner.studies.decisions import (
    Block,
    b_aware_share,
    by_rock,
    load_traces,
    other_views_share,
    per_block,
    same_flight,
)
from tuner.studies.departures.table import DEPARTURES, Departure
from tuner.studies.study_directory import claim, load_settings, settings_tree

SETTINGS_FILE = "departures.yaml"
STUDY = "study of departures"
FLIGHTS = "evaluation"

# Keys without their surface; "costs." ones have none.
METRICS = (
    MetricRow("at 48 mm", "F-score @ 48 mm", "f_score_48mm", "%", True, 2),
    MetricRow("at 48 mm", "Completeness @ 48 mm", "completeness_48mm", "%", True, 2),
    MetricRow("at 48 mm", "Accuracy @ 48 mm", "accuracy_48mm", "%", True, 2),
    MetricRow("distance", "Mean C2C", "c2c_mean_mm", "mm", False, 2),
    MetricRow("distance", "Hausdorff", "hausdorff_gt_to_cloud_mm", "mm", False, 1),
    MetricRow("cost", "Flight time", "costs.flight_time_s", "s", False, 1),
)


@dataclass(frozen=True)
class DepartureSettings:
    """What the study flies.

    Raises
    ------
    UserError
        An unknown arm, preset, gate or path, no rock, or a departure that is set for the base as well.
    """

    rocks: tuple[str, ...]
    replicates: int = 2
    preset: str = "campaign"
    gate: str = "hyb-h"
    overrides: dict[str, Any] = field(default_factory=dict)
    arms: tuple[str, ...] = tuple(DEPARTURES)
    surface: str = "observable"
    runner: str = DEFAULT_RUNNER

    def __post_init__(self) -> None:
        for name in self.arms:
            if name not in DEPARTURES:
                raise UserError(f"unknown departure {name!r}; there are {', '.join(DEPARTURES)}")
        if len(set(self.arms)) != len(self.arms):
            raise UserError("a departure is named twice; name each once")
        if self.surface not in ("observable", "whole"):
            raise UserError(f"surface is {self.surface!r}; choose observable or whole")
        baseline(self.gate)
        if "gate.kind" in self.overrides:
            raise UserError("gate.kind cannot be set here; choose the base's gate with --gate")
        self.plan()

    def base(self, gate: str = "") -> MissionConfig:
        """What the arms depart from, flying ``gate`` or the study's own."""
        base = preset(self.preset).with_values(self.overrides)
        return base.with_values({"gate.kind": gate or self.gate})

    @property
    def flown(self) -> list[Departure]:
        """Arms that change something about the base."""
        return [DEPARTURES[n] for n in self.arms if DEPARTURES[n].applies(self.base(), self.surface)]

    @property
    def as_base(self) -> list[Departure]:
        """Arms that the base has already."""
        return [DEPARTURES[n] for n in self.arms if not DEPARTURES[n].applies(self.base(), self.surface)]

    def reference(self, departure: Departure) -> str:
        """Strategy that ``departure`` is compared with: the base under the same gate."""
        return f"base-{departure.gate or self.gate}"

    def strategy(self, departure: Departure) -> str:
        """Strategy whose missions answer ``departure``."""
        return self.reference(departure) if departure.reads_only else departure.name

    def plan(self) -> EvaluationPlan:
        """Bases and arms; an arm that is the same configuration as another shares its missions."""
        strategies = {f"base-{self.gate}": self.base()}
        for d in self.flown:
            strategies.setdefault(self.reference(d), self.base(d.gate))
        for d in self.flown:
            if not d.reads_only:
                strategies[d.name] = self.base(d.gate).with_values(d.values)
        return EvaluationPlan(strategies, self.rocks, self.replicates, runner=self.runner)

    def to_dict(self) -> dict[str, Any]:
        """YAML form."""
        return settings_tree(self)

    @staticmethod
    def load(directory: Path) -> DepartureSettings:
        """The settings of a study's directory; ``UserError`` if there are none."""
        return load_settings(directory, SETTINGS_FILE, STUDY, DepartureSettings)


def fly(
    settings: DepartureSettings,
    directory: Path,
    executor: Executor,
    on_event: Callable[[EvaluationEvent], None] | None = None,
) -> bool:
    """Fly what is not flown yet; whether the study is complete.

    Raises
    ------
    UserError
        The directory holds something else or cannot be written; a mission met a user's mistake.
    """
    claim(settings, directory, SETTINGS_FILE, STUDY)
    return run_evaluation(settings.plan(), directory / FLIGHTS, executor, on_event).complete


# -- what the missions say -----------------------------------------------------------------------------------


@dataclass(frozen=True)
class BaseResult:
    """The base under one gate."""

    strategy: str
    cells: dict[str, Interval | None]  # by metric key
    b_aware: Interval | None  # percent of captures
    missions: int


@dataclass(frozen=True)
class ArmResult:
    """One departure against its base, on the (rock, replicate) pairs that both finished."""

    departure: Departure
    reference: str
    differences: dict[str, PairedDifference | None]  # by metric key, arm minus base
    b_aware: PairedDifference | None  # percentage points of captures
    other_views: Interval | None  # percent: Jaccard distance of the viewpoints
    pairs: int
    same_flights: int  # pairs that chose the same viewpoints in the same order
    failed: int  # failed missions of the arm

    @property
    def changes_nothing(self) -> bool:
        """Whether every pair is equal to the last bit in everything that is reported."""
        known = [d for d in (*self.differences.values(), self.b_aware) if d is not None]
        return bool(known) and all(d.exactly_zero for d in known)


@dataclass(frozen=True)
class DepartureFindings:
    """All arms of a study."""

    settings: DepartureSettings
    bases: list[BaseResult]
    arms: list[ArmResult]
    missions: int  # with an outcome
    expected: int
    failures: dict[str, int]  # failed missions by reason
    wall_s: float  # of all missions together

    def arm(self, name: str) -> ArmResult:
        """The arm of that name."""
        return next(a for a in self.arms if a.departure.name == name)

    def to_dict(self) -> dict[str, Any]:
        """JSON form."""
        return {
            "settings": self.settings.to_dict(),
            "missions": self.missions,
            "missions_expected": self.expected,
            "failures": self.failures,
            "wall_s": self.wall_s,
            "as_the_base": [d.name for d in self.settings.as_base],
            "bases": [dataclasses.asdict(b) for b in self.bases],
            "arms": [{**dataclasses.asdict(a), "changes_nothing": a.changes_nothing} for a in self.arms],
        }


def metric_key(row: MetricRow, surface: str, variant: str = "") -> str:
    """Path of ``row`` in a mission's metrics."""
    if row.key.startswith("costs."):
        return row.key
    return ".".join(part for part in (variant, surface, row.key) if part)


def analyse(directory: Path) -> DepartureFindings:
    """What the missions of a study's directory say so far.

    Raises
    ------
    UserError
        The directory holds no such study.
    """
    settings = DepartureSettings.load(directory)
    plan = settings.plan()
    records = plan.records(directory / FLIGHTS)
    traces = load_traces(records)
    flown = {r.outcome.directory: r for r in records}.values()  # strategies may share missions
    failures = failure_counts(flown)
    values = functools.partial(_values, settings, records)

    bases = []
    for strategy in [s for s in plan.strategies if s.startswith("base-")]:
        own = {row.key: values(strategy, row, settings.surface, "") for row in METRICS}
        cells = {key: mean_interval(by_rock(found)) for key, found in own.items()}
        share = mean_interval(by_rock(per_block(traces.get(strategy, {}), b_aware_share)))
        bases.append(BaseResult(strategy, cells, share, len(traces.get(strategy, {}))))

    arms = []
    for d in settings.flown:
        strategy, reference = settings.strategy(d), settings.reference(d)
        differences = {
            row.key: paired_difference(
                values(strategy, row, d.surface or settings.surface, d.variant),
                values(reference, row, settings.surface, ""),
                row.higher_is_better,
            )
            for row in METRICS
        }
        ours, theirs = traces.get(strategy, {}), traces.get(reference, {})
        shares = [per_block(t, b_aware_share) for t in (ours, theirs)]
        common = sorted(set(ours) & set(theirs))
        views = {block: other_views_share(ours[block], theirs[block]) for block in common}
        known = {block: share for block, share in views.items() if share is not None}
        arms.append(
            ArmResult(
                d,
                reference,
                differences,
                paired_difference(shares[0], shares[1], True),
                mean_interval(by_rock(known)),
                len(common),
                sum(same_flight(ours[block], theirs[block]) for block in common),
                sum(r.strategy == strategy and r.outcome.status == "failed" for r in records),
            )
        )
    wall_s = sum(r.outcome.wall_s for r in flown)
    return DepartureFindings(settings, bases, arms, len(flown), plan.missions, failures, wall_s)


def _values(
    settings: DepartureSettings,
    records: list[EvaluationRecord],
    strategy: str,
    row: MetricRow,
    surface: str,
    variant: str,
) -> dict[Block, float]:
    return values_of(records, strategy, metric_key(row, surface, variant))
