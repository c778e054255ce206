"""Which configuration to use, of those that have been flown, with its uncertainty."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from tuner.acquisition.constrained import Constraint
from tuner.problem.configurations import configuration_key
from tuner.problem.exact_costs import ExactCost
from tuner.problem.objective import Objective
from tuner.problem.observations import Observation
from tuner.problem.options import Risk
from tuner.problem.search_space import SearchSpace
from tuner.problem.worlds import Place, World
from tuner.recommendation.eligible import may_be_recommended
from tuner.recommendation.fewest_changes import fewest_changes
from tuner.recommendation.inactive import Inactive
from tuner.recommendation.limit import limit_of, next_rock_keeps
from tuner.recommendation.next_rock import next_rock
from tuner.recommendation.recommendation import Candidate, Recommendation, RockRow
from tuner.recommendation.runner_up import cheaper, fewer_changes, runner_up
from tuner.surrogate.forward_check import Calibration, calibration
from tuner.surrogate.kernel import Feature
from tuner.surrogate.known import KnownOutcome
from tuner.surrogate.model import RockMeanGP
from tuner.surrogate.settings import SurrogateSettings

TOP = 5
MAY_KEEP = 0.5  # probability from which on the default is not given up for something dearer
JOINT = 600  # configurations, over worlds, whose joint belief is computed; it grows with the square

# Of a configuration and the numbers of the missions that flew it: what of it changed no choice.
FindInactive = Callable[[Mapping[str, Any], Sequence[int]], list[Inactive]]


def recommend(
    space: SearchSpace,
    observations: Sequence[Observation],
    places: Sequence[Place],
    default: Mapping[str, Any],
    objective: Objective,
    seed: int = 0,
    *,
    replicates: int = 1,
    only_verified: bool = True,
    settings: SurrogateSettings | None = None,
    risk: Risk = "mean",
    feature: Feature | None = None,
    find_inactive: FindInactive | None = None,
    simplify: bool = False,
    constraint: Constraint | None = None,
    exact: ExactCost | None = None,
    second: Objective | None = None,
    limit: float | None = None,
) -> Recommendation | None:
    """The recommendation after ``observations``; None before the first feasible one.

    Parameters
    ----------
    replicates
        The campaign's, per world.
    only_verified
        Whether a configuration has to have flown often enough (`tuner.recommendation.eligible`). Samplers that fly nothing again leave
        no such configuration: theirs is any that has flown.
    settings, feature
        Of the surrogate.
    risk
        The measure over worlds that is meant by the mean everywhere in the result.
    simplify
        Whether to look for a runner-up and at the next rock, which takes two further surrogates.
    constraint
        A limit of the second objective: only what keeps it may be recommended. Where nothing flown does, what is likeliest to.
    exact
        The objective, where the configuration decides it. Outcomes are then those of the second objective.
    second, limit
        The second objective, where there is one, and its limit in its unit.
    find_inactive
        Looks at the choices of the missions that flew a configuration; None: nothing is known of them.
    """
    feasible = [o for o in observations if o.feasible]
    if not feasible:
        return None
    model = RockMeanGP(space, feasible, places, seed, settings, feature)
    if constraint is not None and exact is not None:
        constraint = dataclasses.replace(constraint, model=model)
    groups: dict[tuple[Any, ...], list[Observation]] = {}
    for o in observations:
        groups.setdefault(configuration_key(space, o.values), []).append(o)
    evaluated = {key: group for key, group in groups.items() if any(o.feasible for o in group)}
    configurations = [dict(group[0].values) for group in evaluated.values()]
    allowed = [True] * len(configurations)
    if only_verified:
        allowed = may_be_recommended(space, observations, configurations, places, replicates, default)
    # Where even the default has failed there is nothing better than what has not.
    chosen: Sequence[int] = [i for i, may in enumerate(allowed) if may] or range(len(configurations))
    kept = True
    if constraint is not None:
        keeps = constraint.keeps(configurations)
        every = range(len(configurations))
        chosen = [i for i in chosen if keeps[i] and allowed[i]] or [i for i in every if keeps[i]]
        kept = bool(chosen)
        chosen = chosen or [int(constraint.probability(configurations).argmax())]
    if len(configurations) > JOINT:  # of many only the best, by their means, are looked at jointly
        few = max(TOP, JOINT // len(model.worlds))
        configurations = [configurations[i] for i in chosen]
        best_first: Sequence[int] = model.best_first(configurations, risk)
        if exact is not None:
            best_first = sorted(best_first, key=lambda i: -exact.outcome(configurations[i]))
        own_default = [i for i, values in enumerate(configurations) if values == default]
        configurations = [configurations[i] for i in dict.fromkeys([*best_first[:few], *own_default])]
        chosen = range(len(configurations))
    belief = model.posterior([*configurations, default], risk)
    reference = len(configurations)
    calibrated = calibration(observations)
    modelled = second if exact is not None and second is not None else objective
    goal, among = belief, list(chosen)
    if exact is not None:
        goal = KnownOutcome(space, exact).posterior([*configurations, default], risk)
        least = max(goal.mean[i] for i in among)
        among = [i for i in among if goal.mean[i] == least]
        if goal.mean[reference] >= least and (
            constraint is None or constraint.probability([default])[0] >= MAY_KEEP
        ):
            among = [i for i, v in enumerate(configurations) if v == default] or among  # nothing is cheaper
    index = fewest_changes(configurations, among, default, belief, calibrated, model.noise_sd)
    values, sign = configurations[index], objective.sign
    order = sorted(chosen, key=lambda i: (-goal.mean[i], -belief.mean[i]))
    order = order if index in order else [index, *order]
    top = sorted({*order[: TOP - 1], index}, key=order.index)
    shares = goal.probability_best(top, seed) if exact is None else [float(i == index) for i in top]
    chances = (
        [None] * len(top) if constraint is None else constraint.probability([configurations[i] for i in top])
    )
    candidates = []
    for i, share, chance in zip(top, shares, chances):
        group = evaluated[configuration_key(space, configurations[i])]
        failed = sum(not o.feasible for o in group)
        candidates.append(
            Candidate(
                configurations[i],
                sign * float(goal.mean[i]),
                float(goal.sd[i]),
                len(group),
                failed,
                float(share),
                None if chance is None else float(chance),
            )
        )
    mean, sd = sign * float(goal.mean[index]), float(goal.sd[index])
    gain, gain_sd = goal.difference(index, reference)
    own = evaluated[configuration_key(space, values)]
    inactive = find_inactive(values, [o.number for o in own]) if find_inactive else []
    elsewhere, rival = None, None
    if simplify:
        if values != dict(default):
            departing = dataclasses.replace(model.settings, own_landscapes=True)
            of_rocks = RockMeanGP(space, feasible, places, seed, departing, feature)
            elsewhere = next_rock(of_rocks, values, default, calibrated)
        if exact is None:
            best = configurations[order[0]]
            same = inactive if best == values else []
            predicted = fewer_changes(
                model, feasible, best, same, default, calibrated, risk, constraint, feature, seed, places
            )
            rivals = [predicted, best]
        else:
            rivals = [] if constraint is None else cheaper(model, constraint, exact, values, seed)
        rivals = [v for v in rivals if v not in (values, dict(default))]
        if rivals:
            flown = len(groups.get(configuration_key(space, rivals[0]), []))
            of = model if exact is None else KnownOutcome(space, exact)
            rival = runner_up(of, objective, rivals[0], values, default, flown, calibrated, risk, constraint)
    kept_limit = None
    if constraint is not None and second is not None and limit is not None:
        kept_limit = limit_of(constraint, second, limit, values, default, kept)
        if exact is not None and simplify:
            kept_limit = dataclasses.replace(
                kept_limit,
                next_rock_keeps=next_rock_keeps(model, values, constraint.at_least),
                next_rock_no_worse=None if elsewhere is None else elsewhere.no_worse,
            )
    return Recommendation(
        values=values,
        mean=mean,
        sd=sd,
        interval_95=calibrated.interval_95(mean, sd),
        probability_best=candidates[top.index(index)].probability_best,
        top=candidates,
        per_rock=[_rock_row(model, world, own, values, modelled.sign) for world in model.worlds],
        default_values=dict(default),
        default_mean=sign * float(goal.mean[reference]),
        default_sd=float(goal.sd[reference]),
        improvement=gain,
        improvement_sd=gain_sd,
        improvement_interval_95=calibrated.interval_95(gain, gain_sd),
        probability_better_than_default=_probability(calibrated, gain, gain_sd),
        noise_sd=model.noise_sd,
        block_sd=model.block_sd,
        observations=len(feasible),
        failures=len(observations) - len(feasible),
        metric=objective.metric,
        direction=objective.direction,
        lengthscales=model.lengthscales,
        leave_one_out=model.leave_one_out().to_dict(),
        calibration=calibrated.to_dict(),
        exact=exact is not None,
        modelled_metric=modelled.metric,
        modelled_direction=modelled.direction,
        runner_up=rival,
        inactive=inactive,
        next_rock=elsewhere,
        limit=kept_limit,
    )


def _probability(calibrated: Calibration, gain: float, sd: float) -> float:
    """Return the probability that the gain is above 0: 0 or 1 where the gain is exact and not 0."""
    if sd == 0.0 and gain:
        return float(gain > 0.0)
    return calibrated.probability_positive(gain, sd)


def _rock_row(
    model: RockMeanGP, world: World, own: Sequence[Observation], values: Mapping[str, Any], sign: float
) -> RockRow:
    outcomes = [o.outcome for o in own if o.world == world and o.outcome is not None]
    observed = sign * sum(outcomes) / len(outcomes) if outcomes else None
    predicted = sign * model.predict_in_world(values, world)
    return RockRow(world.rock, len(outcomes), observed, predicted, world.condition)
