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
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

from nbv.config import MissionConfig, preset
from nbv.errors import UserError
from research.decisions import (
    Block,
    b_aware_share,
    by_rock,
    load_traces,
    other_views_share,
    per_block,
    same_flight,
)
from research.departures.table import DEPARTURES, Departure
from research.study_directory import StudyFindings, StudySettings, counts, evaluated
from tuner.evaluation.baselines import baseline
from tuner.evaluation.comparison import (
    Interval,
    MetricRow,
    PairedDifference,
    mean_interval,
    paired_difference,
    values_of,
)
from tuner.evaluation.plan import EvaluationPlan
from tuner.missions.job import Trial
from tuner.missions.registry import DEFAULT_FIDELITY

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
class DepartureSettings(StudySettings):
    """What the study flies.

    Raises
    ------
    UserError
        An unknown arm, preset, gate or path, no rock, or a departure that is set for the base as well.
    """

    FILE: ClassVar[str] = "departures.yaml"
    STUDY: ClassVar[str] = "study of departures"
    rocks: tuple[str, ...]
    replicates: int = 2
    preset: str = "campaign"
    gate: str = "hyb-h"
    overrides: dict[str, Any] = field(default_factory=dict)
    arms: tuple[str, ...] = tuple(DEPARTURES)
    surface: str = "observable"
    fidelity: str = DEFAULT_FIDELITY

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
    def evaluated(self) -> list[Departure]:
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
        for d in self.evaluated:
            strategies.setdefault(self.reference(d), self.base(d.gate))
        for d in self.evaluated:
            if not d.reads_only:
                strategies[d.name] = self.base(d.gate).with_values(d.values)
        return EvaluationPlan(strategies, self.rocks, self.replicates, fidelity=self.fidelity)

    def plans(self) -> dict[str, EvaluationPlan]:
        """The one of `plan`."""
        return {FLIGHTS: self.plan()}


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
class DepartureFindings(StudyFindings[DepartureSettings]):
    """All arms of a study."""

    bases: list[BaseResult]
    arms: list[ArmResult]

    def arm(self, name: str) -> ArmResult:
        """The arm of that name."""
        return next(a for a in self.arms if a.departure.name == name)

    def to_dict(self) -> dict[str, Any]:
        """JSON form."""
        return {
            **super().to_dict(),
            "as_the_base": [d.name for d in self.settings.as_base],
            "bases": [dataclasses.asdict(b) for b in self.bases],
            "arms": [{**dataclasses.asdict(a), "changes_nothing": a.changes_nothing} for a in self.arms],
        }


def metric_key(row: MetricRow, surface: str) -> str:
    """Path of ``row`` in a mission's metrics."""
    return row.key if row.key.startswith("costs.") else f"{surface}.{row.key}"


def analyse(directory: Path) -> DepartureFindings:
    """What the missions of a study's directory say so far.

    Raises
    ------
    UserError
        The directory holds no such study.
    """
    settings = DepartureSettings.load(directory)
    plan = settings.plan()
    records = evaluated(settings, directory)[FLIGHTS]
    traces = load_traces(records)
    values = functools.partial(_values, settings, records)

    bases = []
    for strategy in [s for s in plan.strategies if s.startswith("base-")]:
        own = {row.key: values(strategy, row, settings.surface) for row in METRICS}
        cells = {key: mean_interval(by_rock(found)) for key, found in own.items()}
        share = mean_interval(by_rock(per_block(traces.get(strategy, {}), b_aware_share)))
        bases.append(BaseResult(strategy, cells, share, len(traces.get(strategy, {}))))

    arms = []
    for d in settings.evaluated:
        strategy, reference = settings.strategy(d), settings.reference(d)
        differences = {
            row.key: paired_difference(
                values(strategy, row, d.surface or settings.surface),
                values(reference, row, settings.surface),
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
                sum(r.strategy == strategy and r.status == "failed" for r in records),
            )
        )
    return DepartureFindings(settings, *counts(settings, records), bases, arms)


def _values(
    settings: DepartureSettings,
    records: list[Trial],
    strategy: str,
    row: MetricRow,
    surface: str,
) -> dict[Block, float]:
    return values_of(records, strategy, metric_key(row, surface))
