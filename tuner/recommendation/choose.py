"""Which configuration to use, of those that have been run, with its uncertainty.

Most of what a search moves makes no difference: its values are where the search happened to be. So among the configurations
that are better than the default, with a 95 % interval, the one with the fewest changes is taken that is not worse
than the best of them, or that had exactly its outcomes wherever it was tried. Where none is better, the default is recommended: its gain is inside the noise.

The best of many posterior means is too good more often than not: most of what the surrogate knows of a configuration that
ran once is what it concludes from neighbours, and a planner's outcome jumps wherever another view is chosen. So a
configuration has to have run on two rocks and with two replicates, and where there are several conditions under two (`enough`).
The default was chosen by hand, not by an outcome: nothing flatters it.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np

from tuner.acquisition.constrained import Constraint
from tuner.problem.deterministic_metrics import DeterministicMetric
from tuner.problem.instances import Instance, InstanceLike, are_drawn, conditions_of, instances_of, rocks_of
from tuner.problem.objective import Objective
from tuner.problem.observations import Block, Observation, blocks_evaluated, changes, configuration_key
from tuner.problem.search_space import SearchSpace
from tuner.problem.standardise import FEW
from tuner.recommendation.limit import limit_of
from tuner.recommendation.next_rock import next_rock
from tuner.recommendation.recommendation import Outlier, Recommendation, RockRow, RunnerUp
from tuner.surrogate.model import RockMeanGP
from tuner.surrogate.numerics import numerics
from tuner.surrogate.posterior import DeterministicOutcome, Posterior, interval_95, probability_positive
from tuner.surrogate.settings import SurrogateSettings

TOP = 5
MAY_KEEP = 0.5  # probability from which on the default is not given up for something dearer
JOINT = 600  # configurations, over instances, whose joint belief is computed; it grows with the square
EXPECTED_LOSS = 0.25  # of the noise of a mission
RISK_OF_LOSS = 0.05
SUSPECT, CONTRADICTS = 2.5, 6.0  # standard deviations
ROCKS, CONDITIONS, REPLICATES = 2, 2, 2


@numerics()
def recommend(
    space: SearchSpace,
    observations: Sequence[Observation],
    places: Sequence[InstanceLike],
    default: Mapping[str, Any],
    objective: Objective,
    seed: int = 0,
    *,
    replicates: int = 1,
    only_verified: bool = True,
    settings: SurrogateSettings | None = None,
    constraint: Constraint | None = None,
    exact: DeterministicMetric | None = None,
    second: Objective | None = None,
    limit: float | None = None,
) -> Recommendation | None:
    """Return the recommendation after ``observations``; None before the first feasible one.

    Parameters
    ----------
    space
        The search space.
    observations
        Finished missions.
    places
        The training instances.
    default
        The default values.
    objective
        The metric and its direction.
    seed
        The seed of the fits.
    replicates
        The campaign's, per instance.
    only_verified
        Whether a configuration has to have run often enough (`tuner.recommendation.choose`). Samplers that run nothing again leave
        no such configuration: theirs is any that has run.
    settings
        Of the surrogate.
    constraint
        A limit of the second objective: only what keeps it may be recommended. Where nothing run does, what is likeliest to.
    exact
        The objective, where the configuration decides it. Outcomes are then those of the second objective.
    second, limit
        The second objective, where there is one, and its limit in its unit.
    """
    feasible = [o for o in observations if o.feasible]
    if not feasible:
        return None
    model, outliers = without_outliers(RockMeanGP(space, feasible, places, seed, settings), seed)
    feasible = list(model.observations)
    if constraint is not None and exact is not None:
        constraint = dataclasses.replace(constraint, model=model)
    groups: dict[tuple[Any, ...], list[Observation]] = {}
    for o in (o for o in observations if o not in outliers):
        groups.setdefault(configuration_key(space, o.values), []).append(o)
    evaluated = {key: group for key, group in groups.items() if any(o.feasible for o in group)}
    configurations = [dict(group[0].values) for group in evaluated.values()]
    every = range(len(configurations))
    allowed = [True] * len(configurations)
    if only_verified:
        allowed = may_be_recommended(space, observations, configurations, places, replicates, default)
    keeps = [True] * len(configurations) if constraint is None else constraint.keeps(configurations)
    # Where even the default has failed there is nothing better than what has not.
    chosen = [i for i in every if keeps[i] and allowed[i]] or [i for i in every if keeps[i]]
    kept = bool(chosen)
    if constraint is not None and not kept:
        chosen = [int(constraint.probability(configurations).argmax())]
    if len(configurations) > JOINT:  # of many only the best, by their means, are looked at jointly
        few = max(TOP, JOINT // len(model.instances))
        configurations = [configurations[i] for i in chosen]
        best_first: Sequence[int] = model.best_first(configurations)
        if exact is not None:
            best_first = sorted(best_first, key=lambda i: -exact.outcome(configurations[i]))
        own_default = [i for i, values in enumerate(configurations) if values == default]
        configurations = [configurations[i] for i in dict.fromkeys([*best_first[:few], *own_default])]
        chosen = list(range(len(configurations)))
        keeps = [True] * len(configurations)
    belief = model.posterior([*configurations, default])
    reference = len(configurations)
    modelled = second if exact is not None and second is not None else objective
    goal, among = belief, list(chosen)
    if exact is not None:
        goal = DeterministicOutcome(space, exact).posterior([*configurations, default])
        least = max(goal.mean[i] for i in among)
        among = [i for i in among if goal.mean[i] == least]
        if goal.mean[reference] >= least and (
            constraint is None or constraint.probability([default])[0] >= MAY_KEEP
        ):
            among = [i for i, v in enumerate(configurations) if v == default] or among  # nothing is cheaper
    index = fewest_changes(configurations, among, default, belief, model.noise_sd)
    by_block = [_outcomes(evaluated[configuration_key(space, values)]) for values in configurations]
    index = min(
        (i for i in among if i == index or by_block[index].items() <= by_block[i].items()),
        key=lambda i: len(changes(configurations[i], default)),
    )
    values, sign = configurations[index], objective.sign
    # No number lies beyond all that is believed.
    seen = model.winsorised if exact is None else goal.mean
    shown = np.clip(goal.mean, min(seen), max(seen))
    mean, sd = sign * float(shown[index]), float(goal.sd[index])
    gain, gain_sd = goal.difference(index, reference)
    own = evaluated[configuration_key(space, values)]
    runner_up = None
    rivals = [i for i, keep in enumerate(keeps) if keep and goal.mean[i] > goal.mean[index]]
    if rivals and configurations[rival := max(rivals, key=lambda i: goal.mean[i])] != dict(default):
        difference, improvement = goal.difference(rival, index), goal.difference(rival, reference)
        runner_up = RunnerUp(
            values=configurations[rival],
            missions=len(evaluated[configuration_key(space, configurations[rival])]),
            mean=sign * float(shown[rival]),
            difference=difference[0],
            difference_interval_95=interval_95(*difference),
            improvement=improvement[0],
            improvement_interval_95=interval_95(*improvement),
            probability=None
            if constraint is None
            else float(constraint.probability([configurations[rival]])[0]),
        )
    elsewhere = None
    rocks = rocks_of(model.instances)
    one_rock = len(rocks) == 1 and not are_drawn(rocks)  # how rocks differ is then unknown
    if values != dict(default) and not one_rock and not are_drawn(rocks):
        departing = dataclasses.replace(model.settings, own_landscapes=True)
        of_worlds = RockMeanGP(space, feasible, places, seed, departing)
        elsewhere = next_rock(of_worlds, values, default)
    kept_limit = None
    if constraint is not None and second is not None and limit is not None:
        asked = (exact is not None or constraint.is_share) and not one_rock
        outcomes = [o.second if exact is None else o.outcome for o in own] if asked else None
        no_worse = None if elsewhere is None else elsewhere.no_worse
        kept_limit = limit_of(constraint, second, limit, values, default, kept, outcomes, no_worse)
    return Recommendation(
        values=values,
        mean=mean,
        sd=sd,
        interval_95=interval_95(mean, sd),
        per_rock=[_rock_row(model, instance, own, values, modelled.sign) for instance in model.instances],
        default_values=dict(default),
        default_mean=sign * float(shown[reference]),
        improvement=gain,
        improvement_sd=gain_sd,
        improvement_interval_95=interval_95(gain, gain_sd),
        noise_sd=model.noise_sd,
        observations=len(feasible),
        failures=sum(not o.feasible for o in observations),
        metric=objective.metric,
        direction=objective.direction,
        leave_one_out=model.leave_one_out(),
        exact=exact is not None,
        modelled_metric=modelled.metric,
        runner_up=runner_up,
        next_rock=elsewhere,
        limit=kept_limit,
        outliers=tuple(
            Outlier(o.number, modelled.sign * o.outcome, None if o in outliers else modelled.sign * y)
            for o, y in [*((o, 0.0) for o in outliers), *zip(feasible, model.winsorised)]
            if o.outcome is not None and (o in outliers or o.outcome != y)
        ),
    )


def without_outliers(model: RockMeanGP, seed: int) -> tuple[RockMeanGP, list[Observation]]:
    """Return the model without missions that contradict all others, and these; at most one in `FEW`.

    The mission that is worst predicted by the others is left out where it lies more than `CONTRADICTS` standard deviations from
    what a model fitted without it says.
    """
    left_out: list[Observation] = []
    for _ in range(len(model.observations) // FEW + 1 if len(model.observations) >= FEW // 2 else 0):
        z = np.abs(model.leave_one_out_z())
        worst = model.fitted_to[int(z.argmax())]
        if z.max() < SUSPECT:
            break
        rest, o = list(model.observations), model.observations[worst]
        del rest[worst]
        other = RockMeanGP(model.space, rest, model.instances, seed, model.settings)
        mean, sd = other.predict_mission(o.values, o.instance)
        if abs((o.outcome or 0.0) - mean) <= CONTRADICTS * sd:
            break
        model, left_out = other, [*left_out, o]
    return model, left_out


def fewest_changes(
    configurations: Sequence[Mapping[str, Any]],
    among: Sequence[int],
    default: Mapping[str, Any],
    belief: Posterior,
    noise_sd: float,
) -> int:
    """Return the index of the configuration to use, by the rule in this file's docstring.

    One is not worse than the best where the posterior mean of their difference is no loss above `EXPECTED_LOSS` of a
    mission's noise, and a loss above the noise of one mission has a probability of at most `RISK_OF_LOSS`.

    Parameters
    ----------
    configurations
        All configurations run.
    among
        Indices of those that may be taken; not empty. The default is taken only where it is among them.
    default
        The default values.
    belief
        The joint posterior of ``configurations``, in their order, and of the default behind them.
    noise_sd
        The standard deviation of one mission, objective's unit.
    """
    reference, better = len(configurations), list(among)
    own = [i for i in among if configurations[i] == default]
    if own:
        better = [i for i in among if interval_95(*belief.difference(i, reference))[0] > 0.0]
        if not better:
            return own[0]
    best = max(better, key=lambda i: belief.mean[i])

    def not_worse(i: int) -> bool:
        mean, sd = belief.difference(i, best)
        unlikely = probability_positive(mean + noise_sd, sd) >= 1.0 - RISK_OF_LOSS
        return i == best or (mean >= -EXPECTED_LOSS * noise_sd and (unlikely or sd == 0.0))

    return min(
        filter(not_worse, better), key=lambda i: (len(changes(configurations[i], default)), -belief.mean[i])
    )


def _outcomes(own: Sequence[Observation]) -> dict[Block, float | None]:
    """Return a configuration's outcomes by block: equal outcomes everywhere are the same photographs."""
    return {(o.instance, o.replicate): o.outcome for o in own}


def _rock_row(
    model: RockMeanGP, instance: Instance, own: Sequence[Observation], values: Mapping[str, Any], sign: float
) -> RockRow:
    outcomes = [o.outcome for o in own if o.instance == instance and o.outcome is not None]
    observed = sign * float(sum(outcomes)) / len(outcomes) if outcomes else None
    predicted = sign * model.predict_mission(values, instance)[0]
    return RockRow(instance.rock, len(outcomes), observed, predicted, instance.condition)


def enough(evaluated: Collection[Block], places: Collection[InstanceLike], replicates: int) -> bool:
    """Return whether these blocks cover two training rocks, conditions and replicates, or all where there are fewer."""
    instances = instances_of(places)
    own = [(instance, replicate) for instance, replicate in evaluated if instance in instances]
    seen = [instance for instance, _ in own]
    return (
        len(rocks_of(seen)) >= min(ROCKS, len(rocks_of(instances)))
        and len(conditions_of(seen)) >= min(CONDITIONS, len(conditions_of(instances)))
        and len({k for _, k in own}) >= min(REPLICATES, replicates)
    )


def may_be_recommended(
    space: SearchSpace,
    history: Sequence[Observation],
    configurations: Sequence[Mapping[str, Any]],
    places: Collection[InstanceLike],
    replicates: int,
    default: Mapping[str, Any],
) -> list[bool]:
    """Return for each configuration whether it has run often enough; the default always has.

    Parameters
    ----------
    space
        The search space.
    history
        Finished missions; only feasible ones count.
    configurations
        The configurations in question.
    places
        The training instances.
    replicates
        The campaign's replicates per instance.
    default
        The default values.
    """
    evaluated = blocks_evaluated(space, [o for o in history if o.feasible])
    trusted = configuration_key(space, default)
    keys = [configuration_key(space, values) for values in configurations]
    return [key == trusted or enough(evaluated.get(key, ()), places, replicates) for key in keys]
