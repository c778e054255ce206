"""What to fly after a campaign, from all that was run: its own trials, and every evaluation and confirmation in its directory."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum

from nbv.config import MissionConfig
from nbv.evaluation.registry import find_metric
from tuner.campaign.campaign import Campaign
from tuner.comparison.result import Results, held_out_results, training_results
from tuner.comparison.verdict import Kind, Verdict, best_by_gain, judge
from tuner.problem.baselines import TUNED, base_name, controls_at_equal_number, is_orbit
from tuner.problem.intervals import MIN_ROCKS, Interval
from tuner.problem.observations import mission_key
from tuner.recommendation.recommendation import Recommendation

CEILING = "greedy-oracle"
LITTLE = 1.0  # points: what the oracle gains at most where it is not worth trying planners


class Next(StrEnum):
    RUN = "run the rest of the campaign"
    MORE = "run more missions"
    EVALUATE = "evaluate on held-out instances"
    MORE_INSTANCES = "evaluate on more instances"
    FLY_PLAIN = "fly the plain plan in place of the recommendation"
    FLY = "fly what is recommended"
    TRY_PLANNERS = "fly what is recommended, or try other planners"
    KEEP = "keep the default"


@dataclass(frozen=True)
class Advice:
    """What to fly, and what it is worth on the instances of ``results``.

    ``fly`` is a strategy of the results: the recommendation (``tuned``), unless a plain plan is better on held-out instances with
    a 95 % interval.
    """

    fly: str
    config: MissionConfig
    results: Results
    plain: str  # the best plain plan (an orbit, random views, the default) with as many photographs; empty without one
    is_plain: bool  # whether ``fly`` runs the missions of a plain plan
    over_plain: Verdict | None  # the recommendation against that plan; None where they are one
    over_reference: Verdict | None  # ``fly`` against the reference
    by_orbit: Verdict | None  # the best plain orbit against ``fly``; None where that is one
    # The greedy oracle minus the best plain plan, in points; None where it was not run.
    ceiling: Interval | None

    @property
    def gain(self) -> Interval | None:
        """What the recommendation gains over ``plain``; None where they are one or nothing plain was run."""
        return self.over_plain.gain if self.over_plain else None

    @property
    def instances(self) -> int:
        """On how many the recommendation is judged: those that ``plain`` ran on, too, where it is another one."""
        return len(self.results.rocks) if self.gain is None else self.gain.rocks


def leaves_room(ceiling: Interval | None) -> bool:
    """Whether the oracle was run and gains so much on average that a planner may gain some of it."""
    return ceiling is not None and ceiling.mean > LITTLE


def advice_of(campaign: Campaign, best: Recommendation) -> Advice:
    """Return the advice from everything in the campaign's directory; ``best``: its recommendation."""
    s = campaign.settings
    reference, quality = s.problem.reference, s.goal.shown
    results = held_out_results(campaign, s.problem.config(best.values))
    if results is None or not _plain(results.strategies, reference):
        results = training_results(campaign, best)
    records, missions = results.records, {name: mission_key(c) for name, c in results.strategies.items()}

    def against(strategy: str, other: str) -> Verdict | None:
        """None where one of the two was not run, or both run the same missions."""
        if not {strategy, other} <= missions.keys() or missions[strategy] == missions[other]:
            return None
        return judge(records, strategy, other, quality)

    plain = _plain(results.strategies, reference)
    named = best_by_gain(records, plain, TUNED, quality)
    over_plain = against(TUNED, named)
    metric = find_metric(quality.metric.rpartition(".")[2])
    in_points = metric is not None and metric[0].unit == "%"
    is_worse = over_plain is not None and over_plain.kind is Kind.WORSE
    if in_points and over_plain is not None and over_plain.gain is not None:
        is_worse &= round(over_plain.gain.mean, 1) != 0.0  # less than is shown
    fly = named if results.held_out and is_worse else TUNED
    orbit = best_by_gain(records, filter(is_orbit, plain), TUNED, quality)
    oracle = next((name for name in results.strategies if base_name(name) == CEILING), "")
    return Advice(
        fly=fly,
        config=results.strategies[fly],
        results=results,
        plain=named,
        is_plain=missions[fly] in {missions[name] for name in plain},
        over_plain=over_plain,
        over_reference=against(fly, reference),
        by_orbit=against(orbit, fly),
        ceiling=judge(records, oracle, named, quality).gain if oracle and named and in_points else None,
    )


def _plain(strategies: Mapping[str, MissionConfig], reference: str) -> list[str]:
    """Return the plain plans among ``strategies`` that take as many photographs as the recommendation, it among them."""
    tuned, equal = strategies.get(TUNED), {*controls_at_equal_number(strategies)}
    kinds = [name for name in strategies if is_orbit(name) or base_name(name) in ("random", reference)]
    if tuned is None:
        return kinds
    same = {name for name in kinds if mission_key(strategies[name]) == mission_key(tuned)}
    return [name for name in kinds if name in equal | same]


def next_step(campaign: Campaign, best: Recommendation | None, advice: Advice | None) -> Next:
    s, status = campaign.settings, campaign.status()
    if best is None or advice is None or (status.remaining and not status.exhausted):
        return Next.RUN
    if best.limit is not None and not best.limit.kept:
        return Next.MORE
    if advice.results.held_out:
        enough = min(MIN_ROCKS, len(s.problem.held_out()))
        if advice.instances < enough:
            return Next.MORE_INSTANCES
        if advice.fly != TUNED:
            return Next.FLY_PLAIN
        return Next.TRY_PLANNERS if advice.is_plain and leaves_room(advice.ceiling) else Next.FLY
    if best.keep_default and len(s.problem.arms) == 1:
        return Next.KEEP
    return Next.EVALUATE
