"""Chooses the configurations to recommend among those that have been run, one in every region, with their uncertainty.

Most parameters that a search varies have no effect on the outcome. So of the configurations that are not worse than the best
posterior mean the one with the fewest changes is taken, or one that had exactly its outcomes with fewer. A larger region (the tuned
planner's) has what was chosen in the smaller one (the tuned gate's), unless its own choice is shown to be better. Whether either is
better than a plain plan is not decided here but on missions that both flew (`tuner.answer`).

The largest of many posterior means is usually too large: what the surrogate knows of a configuration that ran once it mostly
infers from neighbours, and a planner's outcome jumps wherever another view is chosen. So a configuration must have run on two
rocks and with two replicates, and where there are several conditions under two (`enough`). The default need not: it was not
selected by its outcomes.
"""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tuner.acquisition.constrained import Constraint, second_model
from tuner.problem.goal import COUNTS, Goal
from tuner.problem.instances import Instance, conditions_of, rocks_of
from tuner.problem.observations import (
    Block,
    Key,
    Observation,
    blocks_evaluated,
    changes,
    configuration_key,
)
from tuner.problem.search_space import Problem, Region, Values
from tuner.problem.standardise import FEW
from tuner.recommendation.recommendation import MORE_FAILURES, Limit, Outlier, Recommendation
from tuner.surrogate.fit import Posterior, interval_95, numerics, probability_positive
from tuner.surrogate.model import InstanceMeanGP

TOP = 5
MAY_KEEP = 0.5  # where nothing meets the constraint: probability from which on the likeliest is taken
JOINT = 600  # configurations, over instances, whose joint posterior is computed; it grows with the square
EXPECTED_LOSS = 0.25  # of the noise of a mission
RISK_OF_LOSS = 0.05
SUSPECT, CONTRADICTS = 2.5, 6.0  # standard deviations
ROCKS, CONDITIONS, REPLICATES = 2, 2, 2


@numerics()
def recommend(
    problem: Problem,
    goal: Goal,
    history: Sequence[Observation],
    *,
    only_verified: bool = True,
) -> dict[str, Recommendation]:
    """Return the recommendation of every region by its name, after the finished missions; nothing before the first feasible one.

    With ``only_verified`` a configuration has to have run often enough, where one of its region has.
    """
    if not any(o.feasible for o in goal.as_shown(history)):
        return {}
    choice = Choice(problem, goal, history, only_verified=only_verified)
    found, smaller = dict[str, Recommendation](), None
    for region in problem.answers:
        if (index := choice.chosen_index(region, smaller)) is not None:
            found[region.name], smaller = choice.recommendation(region.name, index), index
    return found


@dataclass(frozen=True)
class Candidate:
    """A configuration that has run."""

    values: Values
    missions: list[Observation]  # that ran it, failed ones included
    satisfies: bool  # whether it can be taken to meet the constraint
    eligible: bool  # whether it may be recommended; where none can be taken to meet the constraint, those nearest to it

    @property
    def outcomes(self) -> dict[Block, float | None]:
        """Its outcomes by block: equal outcomes everywhere are the same photographs."""
        return {(o.instance, o.replicate): o.outcome for o in self.missions}


def _violations(missions: Sequence[Sequence[Observation]]) -> list[float]:
    """Return by how much each configuration's measured means miss the limit, beside what its instances miss it by on average."""
    seen = [[(o.instance, y) for o in ran if (y := o.second) is not None] for ran in missions]
    of_instance: dict[Any, list[float]] = {}
    for instance, y in itertools.chain(*seen):
        of_instance.setdefault(instance, []).append(y)
    means = {instance: float(np.mean(ys)) for instance, ys in of_instance.items()}
    return [-float(np.mean([y - means[i] for i, y in pairs])) if pairs else np.inf for pairs in seen]


class Choice:
    """The candidates with their joint posterior, the choice among them, and what is said of it."""

    def __init__(
        self, problem: Problem, goal: Goal, history: Sequence[Observation], *, only_verified: bool
    ) -> None:
        observations = goal.as_shown(history)
        every = InstanceMeanGP(problem.space, observations, problem.instances)
        self.problem, self.goal = problem, goal
        self.shown, self.outliers = without_outliers(every, problem.repeatable)
        self.model = self.shown  # of the objective
        if goal.shown is not goal.objective:
            self.model = InstanceMeanGP(problem.space, history, problem.instances)
        # The limit with the model of the limited metric, where there is a mission that has both outcomes.
        both = [o for o in history if o.outcome is not None and o.second is not None]
        self.constraint: Constraint | None = None
        if goal.second is not None and goal.at_least is not None and both:
            limited = self.shown if goal.shown is goal.second else second_model(problem, both)
            self.constraint = Constraint(limited, goal.at_least)
        self.failures = sum(not o.feasible for o in observations)
        self.candidates = self._all_candidates(history, only_verified=only_verified)
        if len(self.candidates) > JOINT:
            # The best eligible ones by posterior mean, few enough for a joint posterior, and the default.
            best_first = self.model.best_first([candidate.values for candidate in self.candidates])
            few = max(TOP, JOINT // len(self.model.instances))
            default = configuration_key(problem.space, problem.default)
            keys = [configuration_key(problem.space, candidate.values) for candidate in self.candidates]
            kept = [i for i in best_first if self.candidates[i].eligible][:few]
            kept += [i for i, key in enumerate(keys) if key == default]
            self.candidates = [self.candidates[i] for i in dict.fromkeys(kept)]
        # In the candidates' order, and the default behind them.
        values = [*(candidate.values for candidate in self.candidates), problem.default]
        self.posterior = self._counts() or self.model.posterior(values)

    def _counts(self) -> Posterior | None:
        """Return the candidates' numbers of photographs, and the default's, as they were counted.

        At 30 missions the model, whose prior expects noise, is off by up to three photographs. None of another objective, and
        where a configuration's missions differ in their number.
        """
        default = [c for c in self.candidates if c.values == dict(self.problem.default)]
        if self.goal.objective.metric not in COUNTS or not default:
            return None
        counts = [
            {o.outcome for o in c.missions if o.outcome is not None} for c in (*self.candidates, *default)
        ]
        if any(len(each) > 1 for each in counts):
            return None
        return Posterior(
            np.concatenate([list(each) for each in counts]), np.zeros((len(counts), len(counts)))
        )

    def _all_candidates(self, observations: Sequence[Observation], *, only_verified: bool) -> list[Candidate]:
        """Return the configurations that have run with success, outliers left out; at least one may be recommended."""
        space, constraint = self.problem.space, self.constraint
        groups: dict[Key, list[Observation]] = {}
        left_out = self.goal.as_shown(self.outliers)  # with their outcomes as they were
        for o in (o for o in observations if o not in left_out):
            groups.setdefault(configuration_key(space, o.values), []).append(o)
        missions = [group for group in groups.values() if any(o.feasible for o in group)]
        values = [dict(group[0].values) for group in missions]
        satisfied = [True] * len(values) if constraint is None else constraint.satisfied(values)
        allowed = [True] * len(values)
        if only_verified:
            allowed = may_be_recommended(self.problem, observations, values)
        # Where even the default has failed there is nothing better than what has not.
        # What has an outcome that all others contradict may be as bad as that.
        contradicted = {configuration_key(space, o.values) for o in self.outliers}
        contradicted -= {configuration_key(space, self.problem.default)}
        allowed = [a and configuration_key(space, v) not in contradicted for a, v in zip(allowed, values)]
        satisfying = [i for i, meets in enumerate(satisfied) if meets]
        eligible = [i for i in satisfying if allowed[i]] or satisfying
        if constraint is not None and not satisfying:
            chance = constraint.probability(values)
            eligible = [int(chance.argmax())]
            if chance.max() < MAY_KEEP:
                least = _violations(missions)
                eligible = [i for i, violation in enumerate(least) if violation <= min(least)]
        return [
            Candidate(value, ran, meets, i in eligible)
            for i, (value, ran, meets) in enumerate(zip(values, missions, satisfied))
        ]

    def plausible(self, outcome: float) -> float:
        """Return an outcome clipped to the range of the measured ones, outliers winsorised."""
        if self.goal.objective.metric in COUNTS:
            return outcome
        return float(np.clip(outcome, min(self.model.winsorised), max(self.model.winsorised)))

    def changes(self, index: int) -> int:
        return len(changes(self.candidates[index].values, self.problem.default))

    def chosen_index(self, region: Region, smaller: int | None = None) -> int | None:
        """Return the index of the candidate to recommend in a region, by the rules in this file's docstring; None where none ran.

        ``smaller``: the one recommended in a smaller region.
        """
        inside = [i for i, candidate in enumerate(self.candidates) if region.contains(candidate.values)]
        among = [i for i in inside if self.candidates[i].eligible] or inside
        if not among:
            return None
        sound = [i for i in among if not self._fails_more(i)] or among
        best = max(sound, key=lambda i: self.posterior.mean[i])
        not_worse = [i for i in sound if self._not_worse(i, best)]
        index = min(not_worse, key=lambda i: (self.changes(i), -self.posterior.mean[i]))
        outcomes = self.candidates[index].outcomes
        theirs = {i: self.candidates[i].outcomes for i in among}
        same = [i for i in among if outcomes.items() <= theirs[i].items()]
        same = [i for i in same if outcomes == theirs[i] or self._not_worse(i, index)]
        index = min(same, key=self.changes)
        if smaller is None or smaller not in among:
            return index
        lead = self.posterior.difference(index, smaller)
        return index if probability_positive(*lead) >= 1.0 - RISK_OF_LOSS else smaller

    def _not_worse(self, i: int, best: int) -> bool:
        """Return whether the posterior mean of the difference is no loss above `EXPECTED_LOSS` of a mission's noise, and a loss
        above the noise of one mission has a probability of at most `RISK_OF_LOSS`."""
        noise_sd = self.model.noise_sd
        mean, sd = self.posterior.difference(i, best)
        unlikely = probability_positive(mean + noise_sd, sd) >= 1.0 - RISK_OF_LOSS
        return i == best or (mean >= -EXPECTED_LOSS * noise_sd and (unlikely or sd == 0.0))

    def _fails_more(self, i: int) -> bool:
        """Return whether a candidate failed in `MORE_FAILURES` of the blocks that the default ran, too, more than that did."""
        default = next((c for c in self.candidates if c.values == dict(self.problem.default)), None)
        one, other = self.candidates[i].outcomes, {} if default is None else default.outcomes
        return sum((one[b] is None) - (other[b] is None) for b in one.keys() & other.keys()) >= MORE_FAILURES

    def recommendation(self, name: str, index: int) -> Recommendation:
        """Return what is said of the candidate that is recommended in a region."""
        problem, goal, posterior = self.problem, self.goal, self.posterior
        sign = goal.objective.sign
        mean, sd = sign * self.plausible(posterior.mean[index]), float(posterior.sd[index])
        gain, gain_sd = posterior.difference(index, len(self.candidates))
        # The missions left out, and those whose outcomes count as other numbers than measured.
        shown_sign, told = goal.shown.sign, zip(self.shown.observations, self.shown.winsorised)
        moved = ((o, shown_sign * y) for o, y in told if o.outcome != y)
        counts_as = [*((o, None) for o in self.outliers), *moved]
        return Recommendation(
            name=name,
            values=self.candidates[index].values,
            missions=len(self.candidates[index].missions),
            mean=mean,
            sd=sd,
            interval_95=interval_95(mean, sd),
            default_values=dict(problem.default),
            default_mean=sign * self.plausible(posterior.mean[-1]),
            improvement=gain,
            improvement_sd=gain_sd,
            improvement_interval_95=interval_95(gain, gain_sd),
            noise_sd=self.shown.noise_sd,
            observations=len(self.shown.observations),
            failures=self.failures,
            metric=goal.objective.metric,
            direction=goal.objective.direction,
            leave_one_out=self.shown.leave_one_out(),
            limit=self._limit(index),
            outliers=tuple(Outlier(o.number, shown_sign * (o.outcome or 0.0), y) for o, y in counts_as),
        )

    def _limit(self, index: int) -> Limit | None:
        """Return how a candidate meets the constraint on the training instances; None where nothing has a limit."""
        constraint, second, limit = self.constraint, self.goal.second, self.goal.limit
        if constraint is None or second is None or limit is None:
            return None
        both = [self.candidates[index].values, self.problem.default]
        posterior, (probability, of_default) = constraint.model.posterior(both), constraint.probability(both)
        mean, default_mean = (second.sign * float(m) for m in posterior.mean)
        sd = float(posterior.sd[0])
        return Limit(
            metric=second.metric,
            direction=second.direction,
            limit=limit,
            satisfied=self.candidates[index].satisfies,
            mean=mean,
            sd=sd,
            interval_95=interval_95(mean, sd),
            probability=float(probability),
            default_probability=float(of_default),
            default_mean=default_mean,
        )


def without_outliers(
    model: InstanceMeanGP, repeatable: Collection[Instance] = ()
) -> tuple[InstanceMeanGP, list[Observation]]:
    """Return the model without missions that contradict all others, and these; at most one in `FEW`.

    The mission that is worst predicted by the others is left out where it lies more than `CONTRADICTS` standard deviations from
    what a model fitted without it says. Missions in an instance with fewer than ``FEW / 2`` stay: an instance may gain more from
    a configuration than the others do, and nothing but its own missions tells that from an outlier. So do those in ``repeatable``
    instances: run again they end the same.
    """
    left_out: list[Observation] = []
    for _ in range(len(model.observations) // FEW + 1):
        of_instance = Counter(o.instance for o in model.observations)
        where = [model.observations[i].instance for i in model.fitted_to]
        enough_beside = [of_instance[i] >= FEW // 2 and i not in repeatable for i in where]
        z = np.where(enough_beside, np.abs(model.leave_one_out_z()), 0.0)
        worst = model.fitted_to[int(z.argmax())]
        if z.max() < SUSPECT:
            break
        rest, o = list(model.observations), model.observations[worst]
        del rest[worst]
        other = InstanceMeanGP(model.space, rest, model.instances)
        mean, sd = other.predict_mission(o.values, o.instance)
        if abs((o.outcome or 0.0) - mean) <= CONTRADICTS * sd:
            break
        model, left_out = other, [*left_out, o]
    return model, left_out


def enough(evaluated: Collection[Block], training: Collection[Instance], replicates: int) -> bool:
    """Return whether these blocks cover two training rocks, conditions and replicates, or all where there are fewer."""
    pairs = [(instance, replicate) for instance, replicate in evaluated if instance in training]
    seen = [instance for instance, _ in pairs]
    return (
        len(rocks_of(seen)) >= min(ROCKS, len(rocks_of(training)))
        and len(conditions_of(seen)) >= min(CONDITIONS, len(conditions_of(training)))
        and len({k for _, k in pairs}) >= min(REPLICATES, replicates)
    )


def may_be_recommended(
    problem: Problem, observations: Sequence[Observation], configurations: Sequence[Mapping[str, Any]]
) -> list[bool]:
    """Return for each configuration whether it has run often enough, failures not counted; the default and the baselines always have."""
    p, evaluated = problem, blocks_evaluated(problem.space, [o for o in observations if o.feasible])
    trusted = {configuration_key(p.space, values) for values in (p.default, *p.arms.values())}
    keys = [configuration_key(p.space, values) for values in configurations]
    return [key in trusted or enough(evaluated.get(key, ()), p.instances, p.replicates) for key in keys]
