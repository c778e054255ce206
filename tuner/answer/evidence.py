"""All missions that count for a campaign's answer: its own trials, and every evaluation and confirmation in its directory.

Each mission stands under the strategies that fly it: the tuned configurations, the baselines, and a tuned configuration with one
group of its parameters as in the paper (`ablations`).
"""

from __future__ import annotations

import collections
import contextlib
import dataclasses
import itertools
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from nbv.config import MissionConfig
from nbv.errors import UserError
from nbv.mission.result import MissionResult
from nbv.rocks.families import SHAPES, generated_name
from tuner.campaign.campaign import Campaign
from tuner.comparison.of_campaign import CONFIRMATION, EVALUATION
from tuner.comparison.plan import PLAN_FILE, EvaluationPlan
from tuner.comparison.statistics import over_rocks, strategy_gain, values_of
from tuner.missions.job import Trial, repeated
from tuner.missions.registry import DEFAULT_FIDELITY
from tuner.problem.baselines import ANSWERS, ablations, is_ablation, scorer_alone
from tuner.problem.goal import Objective
from tuner.problem.intervals import Interval
from tuner.problem.observations import Block, configuration_key, mission_key
from tuner.recommendation.recommendation import Recommendation

ROCKS, SHAPES_WORD = "rocks", "shapes"


def kind_of_target(rock: str) -> str:
    """Return ``shapes`` for a drawn shape that is no rock, else ``rocks``."""
    drawn = generated_name(Path(rock).stem)
    return SHAPES_WORD if drawn is not None and drawn[0] in SHAPES else ROCKS


@dataclass(frozen=True)
class Evidence:
    """Finished missions, each once under every strategy that flies it."""

    configs: Mapping[str, MissionConfig]  # by strategy
    records: Sequence[Trial]
    tuned_on: frozenset[str]  # rocks
    objective: Objective  # by which strategies are compared
    left_out: Sequence[str] = ()  # evaluations that cannot be read, and why

    def on(self, *, held_out: bool) -> Evidence:
        """Return the part on held-out targets, or on those that the campaign was tuned on."""
        chosen = [r for r in self.records if (r.rock not in self.tuned_on) == held_out]
        return dataclasses.replace(self, records=chosen)

    def of_kind(self, kind: str) -> Evidence:
        """Return the part on targets of one kind."""
        return dataclasses.replace(self, records=[r for r in self.records if kind_of_target(r.rock) == kind])

    @property
    def targets(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(r.rock for r in self.records))

    def missions(self, strategy: str) -> list[Trial]:
        return [r for r in self.records if r.strategy == strategy]

    def scores(self, strategy: str) -> dict[Block, float]:
        """Return the score of every mission by block, a failed one's where it counts as one (`score_of`)."""
        return values_of(self.records, strategy, self.objective)

    def mean(self, strategy: str) -> Interval | None:
        """Return the mean score over targets; None without a mission."""
        return over_rocks(self.scores(strategy))

    def gain(self, strategy: str, over: str) -> Interval | None:
        """Return the mean paired difference on the missions that both flew, positive where ``strategy`` is better."""
        return strategy_gain(self.records, strategy, over, self.objective)

    def more_failures(self, strategy: str, than: str) -> int:
        """Return in how many more of the missions that both flew the one failed."""
        failed = [
            {(r.instance, r.replicate): r.record.status == "failed" for r in self.missions(name)}
            for name in (strategy, than)
        ]
        return sum(failed[0][block] - failed[1][block] for block in failed[0].keys() & failed[1].keys())


def evidence_of(campaign: Campaign, found: Mapping[str, Recommendation]) -> Evidence:
    """Return everything that was flown of the present recommendations ``found`` and of what stands beside them.

    Missions with photographs count where there are some, else the others; missions under other conditions than the campaign's, and
    evaluations of earlier recommendations, count for the baselines alone.
    """
    s, problem = campaign.settings, campaign.settings.problem
    configs = {name: problem.config(each.values) for name, each in found.items()}
    for name, config in list(configs.items()):
        configs |= ablations(name, config, problem.base)
    configs |= {name: problem.config(values) for name, values in problem.arms.items()}
    by_fidelity: dict[bool, list[Trial]] = collections.defaultdict(list)
    by_fidelity[s.fidelity == DEFAULT_FIDELITY] += _own_trials(campaign, _name_by_mission(configs))
    under = {condition.name for condition in s.conditions}
    left_out = list[str]()
    for directory, plan in _plans(campaign.directory, left_out):
        names = _names_in(plan, configs)
        for name in names.values():
            configs.setdefault(name, plan.strategies[next(n for n, now in names.items() if now == name)])
        by_fidelity[plan.fidelity == DEFAULT_FIDELITY] += [
            dataclasses.replace(r, strategy=names[r.strategy])
            for r in plan.records(directory)
            if r.strategy in names and r.condition in under
        ]
    # Each mission once under every strategy that flies it.
    flies: dict[str, list[str]] = collections.defaultdict(list)
    keys = {name: mission_key(config) for name, config in configs.items()}
    for name, key in keys.items():
        flies[key].append(name)
    every = {
        (name, r.rock, r.condition, r.replicate): dataclasses.replace(r, strategy=name)
        for r in by_fidelity[True] or by_fidelity[False]
        for name in flies[keys[r.strategy]]
    }
    return Evidence(configs, list(every.values()), frozenset(campaign.rocks_seen()), s.goal.shown, left_out)


def _name_by_mission(configs: Mapping[str, MissionConfig]) -> dict[str, str]:
    """Return the first strategy of each mission by its key."""
    return {mission_key(config): name for name, config in reversed(list(configs.items()))}


def _own_trials(campaign: Campaign, names: Mapping[str, str]) -> list[Trial]:
    """Return the finished trials of the campaign that fly a mission of ``names``."""
    problem = campaign.settings.problem
    name_at = dict[tuple[float, ...], str]()
    records = []
    for t in campaign.trials():
        key = configuration_key(problem.space, t.values)
        if key not in name_at:
            try:
                name_at[key] = names.get(mission_key(problem.config(t.values)), "")
            except UserError:  # values that exclude one another
                name_at[key] = ""
        if t.record.status and name_at[key]:
            records.append(dataclasses.replace(t, strategy=name_at[key]))
    return records


def _plans(directory: Path, left_out: list[str]) -> Iterable[tuple[Path, EvaluationPlan]]:
    for what in (EVALUATION, CONFIRMATION):
        for path in sorted(directory.glob(f"{what}*/{PLAN_FILE}")):
            try:
                yield path.parent, EvaluationPlan.load(path.parent)
            except UserError as error:  # damaged, or with a plug-in that is not given
                left_out.append(str(error))


def _names_in(plan: EvaluationPlan, configs: Mapping[str, MissionConfig]) -> dict[str, str]:
    """Return by strategy of a plan the present strategy that flies the same; those of an earlier recommendation have none."""
    now = _name_by_mission(configs)
    names = dict[str, str]()
    for name, config in plan.strategies.items():
        key = mission_key(config)
        if key in now:
            names[name] = now[key]
        elif name not in ANSWERS and not is_ablation(name) and name not in configs:
            names[name] = name
    return names


# What the gate of a tuned configuration did, from the traces of its missions.


@dataclass(frozen=True)
class GateFacts:
    """Over the missions of the campaign that flew one configuration, and over all its missions that planned a view."""

    missions: int  # that flew the configuration
    switched: int  # of these: views of more than one scorer were taken
    views: Mapping[str, int]  # planned views by the scorer that chose them
    d95_m: tuple[float, float] | None  # between which the statistic lay when a view was chosen
    all_missions: int  # of the campaign, that planned a view and took other photographs than those before
    all_switched: int
    alone: str  # the scorer that the thresholds leave alone whatever is measured; empty without one


def gate_facts(campaign: Campaign, tuned: Recommendation) -> GateFacts:
    """Return what the gate did; files of missions that are gone are left out."""
    every = campaign.trials()
    again = repeated(every)
    trials = [t for t in every if t.state == "complete" and t.record.switched is not None]
    new = [t for t in trials if t.number not in again]
    flown = [t for t in trials if dict(t.values) == dict(tuned.values)]
    traces = []
    for t in flown:
        with contextlib.suppress(UserError, OSError):
            traces.append(MissionResult.load(t.record.directory).trace)
    steps = list(itertools.chain(*traces))
    d95_m = [step.d95_m for step in steps if step.d95_m is not None]
    return GateFacts(
        missions=len(flown),
        switched=sum(bool(t.record.switched) for t in flown),
        views=dict(collections.Counter(step.scorer for step in steps).most_common()),
        d95_m=(min(d95_m), max(d95_m)) if d95_m else None,
        all_missions=len(new),
        all_switched=sum(bool(t.record.switched) for t in new),
        alone=scorer_alone(campaign.settings.problem.config(tuned.values)),
    )
