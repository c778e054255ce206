"""When is a sample covered? Hyb-O under every reading of the paper's text, and what each of them gains.

The strategies: Hyb-O with every ``gate.oracle_coverage``, the greedy oracle with those that do not saturate at
once, and the deployable strategies they are compared with. Every mission logs what the oracle of its coverage
would have gained from both scorers' best candidates, so the deployable ones say how often the default oracle
disagrees with them. The run directory is a study of departures' with ``oracles.*``.
"""

from __future__ import annotations

import dataclasses
import statistics
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, get_args, get_type_hints

from nbv.config import GateConfig, MissionConfig, preset
from nbv.errors import UserError
from nbv.mission.result import IterationRecord
from nbv.scorers import B_AWARE, COVIS, PAPER_SCORERS
from research.decisions import (
    PERCENT,
    Traces,
    b_aware_share,
    by_rock,
    load_traces,
    other_views_share,
    per_block,
)
from research.departures.study import FLIGHTS, METRICS, metric_key
from research.study_directory import StudyFindings, StudySettings, counts, evaluated
from tuner.evaluation.baselines import baseline
from tuner.evaluation.comparison import (
    Interval,
    MetricRow,
    PairedDifference,
    mean_interval,
    strategy_difference,
    strategy_interval,
)
from tuner.evaluation.plan import EvaluationPlan
from tuner.missions.job import Trial
from tuner.missions.registry import DEFAULT_FIDELITY
from tuner.problem.search_space import builtin

COVERAGES: tuple[str, ...] = get_args(get_type_hints(GateConfig)["oracle_coverage"])
REFERENCES = ("covis", "b-aware", "hyb-h")


@dataclass(frozen=True)
class OracleSettings(StudySettings):
    """What the study flies.

    Raises
    ------
    UserError
        An unknown coverage, preset or path, or no rock.
    """

    FILE: ClassVar[str] = "oracles.yaml"
    STUDY: ClassVar[str] = "study of oracles"
    rocks: tuple[str, ...]
    replicates: int = 2
    preset: str = "campaign"
    overrides: dict[str, Any] = field(default_factory=dict)
    coverages: tuple[str, ...] = COVERAGES
    greedy: tuple[str, ...] = ("reconstruction", "seen", "matchable")  # coverages of the greedy oracle
    references: tuple[str, ...] = REFERENCES
    surface: str = "observable"
    fidelity: str = DEFAULT_FIDELITY

    def __post_init__(self) -> None:
        for coverage in (*self.coverages, *self.greedy):
            if coverage not in COVERAGES:
                raise UserError(f"unknown coverage {coverage!r}; choose from {', '.join(COVERAGES)}")
        if not self.coverages:
            raise UserError("no coverage to study; name at least one")
        if self.surface not in ("observable", "whole"):
            raise UserError(f"surface is {self.surface!r}; choose observable or whole")
        for name in self.references:
            if baseline(name).uses_ground_truth:
                raise UserError(f"{name!r} looks at the ground truth; compare with a deployable strategy")
        for path in ("gate.kind", "gate.oracle_coverage"):
            if path in self.overrides:
                raise UserError(f"{path} cannot be set here: the study flies its values")
        self.plan()

    @property
    def base(self) -> MissionConfig:
        """What all strategies have in common."""
        return preset(self.preset).with_values(self.overrides)

    @property
    def oracles(self) -> dict[str, str]:
        """Coverage by oracle strategy."""
        return {
            **{f"hyb-o-{coverage}": coverage for coverage in self.coverages},
            **{f"greedy-{coverage}": coverage for coverage in self.greedy},
        }

    def plan(self) -> EvaluationPlan:
        """References, then oracles."""
        strategies = {name: baseline(name).config(self.base) for name in self.references}
        for name, coverage in self.oracles.items():
            kind = "hyb-o" if name.startswith("hyb-o-") else "greedy-oracle"
            values = {"gate.kind": kind, "gate.oracle_coverage": coverage}
            strategies[name] = self.base.with_values(values)
        return EvaluationPlan(strategies, self.rocks, self.replicates, fidelity=self.fidelity)

    def plans(self) -> dict[str, EvaluationPlan]:
        """The one of `plan`."""
        return {FLIGHTS: self.plan()}


# -- one mission ---------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Preferences:
    """How one mission's oracle judged both scorers' best candidates; counts of decisions."""

    decisions: int
    b_aware: int  # strictly more gained by B-aware's
    covis: int  # strictly more gained by Covis's
    same_candidate: int  # ties because both scorers chose the same viewpoint
    saturated: int  # other ties, with nothing to gain from either
    other_ties: int
    saturates_at: int | None  # first decision at which neither has anything to gain

    @property
    def ties(self) -> int:
        """Decisions on which the oracle is indifferent."""
        return self.same_candidate + self.saturated + self.other_ties


@dataclass(frozen=True)
class Judgement:
    """What an oracle says about one decision."""

    iteration: int
    b_aware: float  # what B-aware's best candidate would gain
    covis: float
    same_candidate: bool  # whether that is Covis's best candidate too


def judgements(trace: Sequence[IterationRecord]) -> list[Judgement]:
    """The logged rewards of a mission; decisions without them are left out."""
    found = []
    for record in trace:
        rewards, top = record.oracle_rewards, record.top
        if all(name in rewards for name in PAPER_SCORERS):
            best = {top.get(name, {}).get("candidate", name) for name in PAPER_SCORERS}
            b_aware, covis = rewards[B_AWARE.name], rewards[COVIS.name]
            found.append(Judgement(record.iteration, b_aware, covis, len(best) == 1))
    return found


def preferences(judged: Sequence[Judgement]) -> Preferences | None:
    """How one mission was judged; None if it was not."""
    counts = {"b_aware": 0, "covis": 0, "same_candidate": 0, "saturated": 0, "other_ties": 0}
    saturates_at: int | None = None
    for j in judged:
        nothing = j.b_aware == 0 and j.covis == 0
        if nothing and saturates_at is None:
            saturates_at = j.iteration
        if j.b_aware != j.covis:
            counts["b_aware" if j.b_aware > j.covis else "covis"] += 1
        elif nothing:
            counts["saturated"] += 1
        else:
            counts["same_candidate" if j.same_candidate else "other_ties"] += 1
    return Preferences(len(judged), **counts, saturates_at=saturates_at) if judged else None


def covered_shares(trace: Sequence[IterationRecord]) -> tuple[float, float] | None:
    """Percent of the samples covered before the first and before the last capture; greedy oracles log it."""
    shares = [r.gate_details["covered_fraction"] for r in trace if "covered_fraction" in r.gate_details]
    return (PERCENT * shares[0], PERCENT * shares[-1]) if shares else None


# -- all missions --------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class StrategyResult:
    """One strategy over all rocks and replicates."""

    strategy: str
    coverage: str  # of the oracle that judged its decisions
    missions: int
    failed: int
    cells: dict[str, Interval | None]  # by metric key
    differences: dict[
        str, dict[str, PairedDifference | None]
    ]  # by reference, then metric key; itself minus it
    other_views: dict[str, Interval | None]  # by reference: Jaccard distance of the viewpoints, percent
    flew_b_aware: Interval | None  # percent of captures
    decisions: int
    prefers_b_aware: Interval | None  # percent of decisions
    prefers_covis: Interval | None
    ties: Interval | None
    same_candidate: int  # ties by kind, decisions of all missions
    saturated: int
    other_ties: int
    missions_preferring_b_aware: int
    missions_preferring_covis: int
    missions_saturated: int  # with a decision without anything to gain
    saturates_at: float | None  # median first such decision, over these missions
    covered_first: float | None  # percent of samples, means over missions; greedy oracles log it
    covered_last: float | None

    @property
    def switches(self) -> bool:
        """Whether the oracle ever strictly preferred either scorer: an oracle that does not is degenerate."""
        return self.missions_preferring_b_aware > 0 and self.missions_preferring_covis > 0


@dataclass(frozen=True)
class OracleFindings(StudyFindings[OracleSettings]):
    """All strategies of a study."""

    strategies: list[StrategyResult]

    def strategy(self, name: str) -> StrategyResult:
        """The strategy of that name."""
        return next(s for s in self.strategies if s.strategy == name)

    def to_dict(self) -> dict[str, Any]:
        """JSON form."""
        return {
            **super().to_dict(),
            "strategies": [{**dataclasses.asdict(s), "switches": s.switches} for s in self.strategies],
        }


def analyse(directory: Path) -> OracleFindings:
    """What the missions of a study's directory say so far.

    Raises
    ------
    UserError
        The directory holds no such study.
    """
    settings = OracleSettings.load(directory)
    plan = settings.plan()
    records = evaluated(settings, directory)[FLIGHTS]
    traces = load_traces(records)
    rows = [dataclasses.replace(row, key=metric_key(row, settings.surface)) for row in METRICS]
    results = [
        _strategy_result(settings, records, traces, rows, name, builtin(config).gate.oracle_coverage)
        for name, config in plan.strategies.items()
    ]
    return OracleFindings(settings, *counts(settings, records), results)


def _strategy_result(
    settings: OracleSettings,
    records: Sequence[Trial],
    traces: Traces,
    rows: Sequence[MetricRow],
    name: str,
    coverage: str,
) -> StrategyResult:
    own = traces.get(name, {})
    judged = {block: p for block, t in own.items() if (p := preferences(judgements(t))) is not None}
    covered = [shares for t in own.values() if (shares := covered_shares(t)) is not None]
    saturating = [p.saturates_at for p in judged.values() if p.saturates_at is not None]
    against = [r for r in settings.references if r != name]

    def share(count: Callable[[Preferences], int]) -> Interval | None:
        return mean_interval(
            by_rock({block: PERCENT * count(p) / p.decisions for block, p in judged.items()})
        )

    def views(reference: str) -> Interval | None:
        theirs = traces.get(reference, {})
        found = {block: other_views_share(own[block], theirs[block]) for block in set(own) & set(theirs)}
        return mean_interval(by_rock({block: v for block, v in found.items() if v is not None}))

    return StrategyResult(
        strategy=name,
        coverage=coverage,
        missions=len(own),
        failed=sum(r.strategy == name and r.status == "failed" for r in records),
        cells={row.key: strategy_interval(records, name, row.key) for row in rows},
        differences={
            reference: {row.key: strategy_difference(records, name, reference, row) for row in rows}
            for reference in against
        },
        other_views={reference: views(reference) for reference in against},
        flew_b_aware=mean_interval(by_rock(per_block(own, b_aware_share))),
        decisions=sum(p.decisions for p in judged.values()),
        prefers_b_aware=share(lambda p: p.b_aware),
        prefers_covis=share(lambda p: p.covis),
        ties=share(lambda p: p.ties),
        same_candidate=sum(p.same_candidate for p in judged.values()),
        saturated=sum(p.saturated for p in judged.values()),
        other_ties=sum(p.other_ties for p in judged.values()),
        missions_preferring_b_aware=sum(p.b_aware > 0 for p in judged.values()),
        missions_preferring_covis=sum(p.covis > 0 for p in judged.values()),
        missions_saturated=len(saturating),
        saturates_at=float(statistics.median(saturating)) if saturating else None,
        covered_first=statistics.mean(first for first, _ in covered) if covered else None,
        covered_last=statistics.mean(last for _, last in covered) if covered else None,
    )
