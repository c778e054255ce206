"""The answer of a campaign as one record, from all its missions: ``answer.json``.

Plans are compared on missions that both flew, a failed one counted as 0. What is not shown to differ is a tie, and a tie goes to the
plan that is the simplest to fly, the first in `SIMPLEST_FIRST`.
"""

from __future__ import annotations

import collections
import json
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any

from nbv.config import MissionConfig
from nbv.safe_files import json_ready, write_atomic
from tuner.answer.evidence import ROCKS, SHAPES_WORD, Evidence, GateFacts, evidence_of, gate_facts
from tuner.campaign.campaign import Campaign
from tuner.comparison.statistics import same_photographs
from tuner.missions.job import repeated
from tuner.problem.baselines import (
    ANSWERS,
    SIMPLEST_FIRST,
    base_name,
    in_table_order,
    is_ablation,
    kind_of,
    label,
)
from tuner.problem.intervals import MIN_ROCKS, Interval
from tuner.recommendation.recommendation import MORE_FAILURES, Recommendation

ANSWER_FILE = "answer.json"
WORTH_KNOWING = 1.0  # a lead, in the metric's unit, that is worth more missions
BEST_ORBITS = ("orbit-middle", "orbit-high")  # beside which a tuned plan is evaluated
# Phases of trials, as a reader calls what chose them.
CHOSEN_BY = {
    "default": "baselines",
    "arm": "baselines",
    "begin": "design",
    "earlier missions": "design",
    "initial design": "design",
    "exploration": "design",
    "random": "design",
    "model": "model",
    "verification": "verification",
    "simplified": "",  # which takes no photograph of its own
}


@dataclass(frozen=True)
class StrategyRow:
    """A strategy on the targets of a table."""

    strategy: str
    label: str
    kind: str  # the paper's, tuned, controls, oracles
    photographs: float | None
    planned: float | None
    flight_s: float | None
    means: Mapping[str, float | None]  # of the score by kind of target
    from_reference: Interval | None  # paired, positive where it is better
    from_baseline: Interval | None  # the same from the best plain plan
    missions: int
    failures: int
    targets: int
    same_as: str  # an earlier strategy whose photographs it took


@dataclass(frozen=True)
class AnswerTable:
    held_out: bool
    targets: tuple[str, ...]
    kinds: tuple[str, ...]  # of targets, those that there are
    replicates: tuple[int, int]  # fewest and most of one target
    rows: tuple[StrategyRow, ...]
    best_plain: str  # the best plain plan there; empty without one
    reference: str  # the strategy of `StrategyRow.from_reference`


@dataclass(frozen=True)
class Advice:
    """What to fly, and against what that is known."""

    strategy: str
    label: str
    is_tuned: bool
    # Paired gains over the other plans that may be flown, on all targets.
    against: Mapping[str, Interval | None]
    leads: Mapping[str, Interval]  # plans with a better mean that are not shown to be better, and by how much
    targets: int  # on which it has flown
    shown: bool  # whether it is better than the simplest plan beyond chance


@dataclass(frozen=True)
class Next:
    why: str
    command: str


@dataclass(frozen=True)
class Answer:
    metric: str
    direction: str
    photographs: int
    finished: int
    budget: int
    chosen_by: Mapping[str, int]  # missions of the campaign by what chose them
    failures: Mapping[str, int]  # of the campaign's missions, by reason
    recommended: Mapping[str, Recommendation]  # the tuned configurations, by name
    gates: Mapping[str, GateFacts]  # what their gates did
    tables: tuple[AnswerTable, ...]  # held-out targets first
    fly: Advice | None
    next: Next
    nothing_yet: str = ""
    left_out: tuple[str, ...] = ()  # evaluations that cannot be read, and why
    configs: Mapping[str, MissionConfig] = field(default_factory=dict, repr=False)  # by strategy

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON form: everything but the configurations."""
        return {f.name: json_ready(getattr(self, f.name)) for f in fields(self) if f.name != "configs"}

    def save(self, campaign: Campaign) -> None:
        """Write it into the campaign's directory; ``OSError`` where that cannot be written."""
        write_atomic(campaign.directory / ANSWER_FILE, json.dumps(self.to_dict(), indent=1))


def answer_of(campaign: Campaign) -> Answer:
    """Return the answer after all missions of the campaign, its evaluations and confirmations."""
    s, status = campaign.settings, campaign.status()
    found = campaign.recommendations(save=False)
    evidence = evidence_of(campaign, found)
    number = s.problem.config(s.problem.default).photographs
    if found:
        tuned = list(found)[-1]
        config = evidence.configs[tuned]
        taken = campaign.mean_photographs(found[tuned].values) if config.stop.may_end_early else None
        number = taken or config.photographs
    tables = [
        table_of(evidence.on(held_out=held_out), held_out, s.problem.reference, number)
        for held_out in (True, False)
    ]
    tables = [table for table in tables if table.rows and found]
    fly = flight_of(evidence, found, number) if found else None
    counts: dict[str, int] = collections.Counter()
    trials = campaign.trials()
    again = repeated(trials)  # they took the photographs of an earlier mission
    for t in trials:
        if (
            t.number not in again
            and t.record.status
            and (by := CHOSEN_BY.get(str(t.record.metadata.get("phase")), "design"))
        ):
            counts[by] += 1
    return Answer(
        metric=s.goal.shown.metric,
        direction=s.goal.shown.direction,
        photographs=number,
        finished=status.finished,
        budget=status.budget,
        chosen_by={by: counts[by] for by in ("baselines", "design", "model", "verification")},
        failures=status.failures,
        recommended=found,
        gates={name: gate_facts(campaign, each) for name, each in found.items()},
        tables=tuple(tables),
        fly=fly,
        next=next_step(campaign, found, tables, fly),
        nothing_yet=campaign.nothing_yet(),
        left_out=tuple(evidence.left_out),
        configs=evidence.configs,
    )


def table_of(evidence: Evidence, held_out: bool, reference: str, number: int) -> AnswerTable:
    """Return the strategies on the targets of ``evidence``; ablations stand in the table of what earned the gain."""
    flown = {r.strategy for r in evidence.records}
    names = in_table_order(name for name in evidence.configs if name in flown and not is_ablation(name))
    twins = same_photographs(evidence.records, list(evidence.configs))
    kinds = [kind for kind in (ROCKS, SHAPES_WORD) if evidence.of_kind(kind).records]
    of_kind = {kind: evidence.of_kind(kind) for kind in kinds} if len(kinds) > 1 else {}
    plain = best_plain(evidence, plain_plans(evidence, number))
    counts = collections.Counter(
        r.rock for r in evidence.records if r.strategy == (names[0] if names else "")
    )

    def row(name: str) -> StrategyRow:
        missions = evidence.missions(name)
        costs = {
            key: _mean([r.value(key) for r in missions]) for key in ("costs.images", "costs.flight_time_s")
        }
        parts = {"all": evidence, **of_kind}
        means = {
            kind: None if (mean := part.mean(name)) is None else mean.mean for kind, part in parts.items()
        }
        config = evidence.configs[name]
        return StrategyRow(
            strategy=name,
            label=label(name),
            kind=kind_of(name),
            photographs=costs["costs.images"],
            planned=None if config.stop.may_end_early else float(config.planned_views),
            flight_s=costs["costs.flight_time_s"],
            means=means,
            from_reference=None if name == reference else evidence.gain(name, reference),
            from_baseline=None if name == plain or not plain else evidence.gain(name, plain),
            missions=len(missions),
            failures=sum(r.record.status == "failed" for r in missions),
            targets=len({r.rock for r in missions}),
            same_as=twins.get(name, ""),
        )

    return AnswerTable(
        held_out,
        evidence.targets,
        tuple(kinds),
        (min(counts.values(), default=0), max(counts.values(), default=0)),
        tuple(map(row, names)),
        plain,
        reference,
    )


def plain_plans(evidence: Evidence, number: int) -> list[str]:
    """Return the plans without tuning that take as many photographs, the simplest first."""
    return [
        name
        for base in SIMPLEST_FIRST
        for name in evidence.configs
        if base_name(name) == base
        and evidence.configs[name].photographs == number
        and evidence.missions(name)
    ]


def best_plain(evidence: Evidence, plain: Sequence[str]) -> str:
    """Return the plain plan with the best mean on the missions that it shares with the first of them; empty without one."""
    gains = {name: evidence.gain(name, plain[0]) for name in plain}
    return max((name for name, gain in gains.items() if gain), key=lambda name: gains[name].mean, default="")  # type: ignore[union-attr]


def flight_of(evidence: Evidence, found: Mapping[str, Recommendation], number: int) -> Advice | None:
    """Return the simplest plan, unless one is shown to be better on shared missions, a tuned one than the best plain plan as well."""
    tuned = [name for name in ANSWERS if name in found and evidence.missions(name)]
    plain = plain_plans(evidence, number)
    plans = [*plain, *tuned]
    plans = [name for name in plans if name not in tuned or not found[name].missed] or plans
    if not plans:
        return None
    fly = plans[0]
    for name in plans[1:]:
        if is_better(evidence, name, fly):
            fly = name
    best = best_plain(evidence, plain)
    if fly in tuned and best and not is_better(evidence, fly, best):  # better than the simplest alone
        fly = best
    against = {name: evidence.gain(fly, name) for name in plans if name != fly}
    leads = {
        name: gain.reversed for name, gain in against.items() if gain is not None and round(gain.mean, 1) < 0
    }
    return Advice(
        strategy=fly,
        label=label(fly),
        is_tuned=fly in ANSWERS,
        against=against,
        leads=leads,
        targets=len({r.rock for r in evidence.missions(fly)}),
        shown=fly != plans[0],
    )


def is_better(evidence: Evidence, name: str, than: str) -> bool:
    """Return whether one plan is shown to be better than another: by failures, or by the 95 % interval of the paired difference."""
    more = evidence.more_failures(name, than)
    if abs(more) >= MORE_FAILURES:
        return more < 0
    gain = evidence.gain(name, than)
    return gain is not None and gain.low is not None and gain.low > 0 and round(gain.mean, 1) > 0


def next_step(
    campaign: Campaign, found: Mapping[str, Recommendation], tables: Sequence[AnswerTable], fly: Advice | None
) -> Next:
    """Return what to do now, and its command."""
    status, run = campaign.status(), shlex.quote(str(campaign.directory))
    targets = next((table.targets for table in tables if table.held_out), ())
    if not found or (status.remaining and not status.exhausted):
        if status.failures and not status.complete:
            reason = max(status.failures, key=lambda r: status.failures[r])
            return Next(
                f"Every mission failed, most often with {reason!r}: correct that, then resume.",
                f"gatetune campaign resume {run}",
            )
        return Next(
            f"Finish it: {status.remaining} of {status.budget} missions are left.",
            f"gatetune campaign resume {run}",
        )
    if any(each.missed for each in found.values()):
        return Next(
            "Run more missions, or relax the constraint: nothing that was run is known to meet it.",
            f"gatetune campaign resume {run} --missions {2 * status.budget}",
        )
    if (count := len(targets)) < MIN_ROCKS:
        few = f"more targets: {count} held-out target{'s' * (count > 1)} cannot stand for others"
        why = few if targets else "held-out targets: all that counts so far ran where it was tuned"
        return Next(f"Evaluate it on {why}.", f"gatetune evaluate {run}")
    drawn, leads = {*campaign.held_out()}, fly.leads if fly else {}
    flown = drawn & {*targets}
    lead = max((gain.mean for name, gain in leads.items() if name in ANSWERS), default=0.0)
    against = (campaign.settings.problem.reference, *([fly.strategy] if fly else []), *BEST_ORBITS)
    if lead >= WORTH_KNOWING and flown and flown != drawn and not drawn & campaign.rocks_seen():
        return Next(
            f"Evaluate it on {len(drawn)} held-out targets: they may show whether the lead of {lead:.1f} is a difference.",
            " --against ".join([f"gatetune evaluate {run} --replicates 1", *dict.fromkeys(against)]),
        )
    return Next("Export what to fly.", f"gatetune export {run}")


def _mean(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return sum(known) / len(known) if known else None
