"""Which configuration to use: the best posterior mean over the training worlds, with its uncertainty."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from tuner.acquisition.within import Within
from tuner.problem.configurations import configuration_key
from tuner.problem.objective import Objective
from tuner.problem.observations import Observation
from tuner.problem.options import Risk
from tuner.problem.search_space import SearchSpace
from tuner.problem.worlds import Place, World
from tuner.recommendation.eligible import may_be_recommended
from tuner.recommendation.inactive import Inactive
from tuner.recommendation.next_rock import next_rock
from tuner.recommendation.recommendation import Candidate, Recommendation, RockRow, SecondObjective
from tuner.recommendation.sparsest import sparsest
from tuner.surrogate.forward_check import calibration
from tuner.surrogate.kernel import Feature
from tuner.surrogate.model import RockMeanGP
from tuner.surrogate.settings import SurrogateSettings

TOP = 5
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
    within: Within | None = None,
) -> Recommendation | None:
    """The recommendation after ``observations``; None before the first feasible one.

    Parameters
    ----------
    replicates
        The campaign's, per world.
    only_verified
        Whether a configuration has to have flown often enough (`tuner.recommendation.eligible`). Samplers that fly nothing again leave
        no such configuration: theirs is the best posterior mean.
    settings, feature
        Of the surrogate.
    risk
        The measure over worlds that is meant by the mean everywhere in the result.
    simplify
        Whether to look for the sparsest configuration and at the next rock, which takes two further surrogates.
    within
        A limit of a second objective: only what keeps it may be recommended. Where nothing flown does, what is likeliest to.
    find_inactive
        Looks at the choices of the missions that flew a configuration; None: nothing is known of them.
    """
    feasible = [o for o in observations if o.feasible]
    if not feasible:
        return None
    model = RockMeanGP(space, feasible, places, seed, settings, feature)
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
    if within is not None:
        keeps = within.keeps(configurations)
        every = range(len(configurations))
        chosen = [i for i in chosen if keeps[i] and allowed[i]] or [i for i in every if keeps[i]]
        kept = bool(chosen)
        chosen = chosen or [int(within.probability(configurations).argmax())]
    if len(configurations) > JOINT:  # of many only the best, by their means, are looked at jointly
        configurations = [configurations[i] for i in chosen]
        best_first = model.best_first(configurations, risk)[: max(TOP, JOINT // len(model.worlds))]
        configurations = [configurations[i] for i in best_first]
        chosen = range(len(configurations))
    belief = model.posterior([*configurations, default], risk)
    reference = len(configurations)
    order = sorted(chosen, key=lambda i: -belief.mean[i])
    calibrated = calibration(observations)
    top = order[:TOP]
    shares = belief.probability_best(top, seed)
    best, sign = top[0], objective.sign

    candidates = []
    for index, share in zip(top, shares):
        group = evaluated[configuration_key(space, configurations[index])]
        failed = sum(not o.feasible for o in group)
        candidates.append(
            Candidate(
                configurations[index],
                sign * float(belief.mean[index]),
                float(belief.sd[index]),
                len(group),
                failed,
                float(share),
            )
        )
    mean, sd = candidates[0].mean, candidates[0].sd
    gain, gain_sd = belief.difference(best, reference)
    own = evaluated[configuration_key(space, configurations[best])]
    inactive = find_inactive(configurations[best], [o.number for o in own]) if find_inactive else []
    simple, elsewhere = None, None
    if simplify:
        # Its missions would have been the same with these at the default: that is where they count.
        free = {found.path: default[found.path] for found in inactive if found.default_is_the_same}
        few: Sequence[Observation] = feasible
        if free:
            same = [o.number for o in own]
            few = [
                dataclasses.replace(o, values={**o.values, **free}) if o.number in same else o
                for o in feasible
            ]
        of_few = model
        if free or not model.settings.sparse:
            sparse = dataclasses.replace(model.settings, sparse=True)
            of_few = RockMeanGP(space, few, places, seed, sparse, feature)
        simple = sparsest(
            of_few, {**configurations[best], **free}, default, calibrated, sign, risk, within, model
        )
        if configurations[best] != dict(default):
            departing = dataclasses.replace(model.settings, own_landscapes=True)
            of_rocks = RockMeanGP(space, feasible, places, seed, departing, feature)
            elsewhere = next_rock(of_rocks, configurations[best], default, calibrated)
    return Recommendation(
        values=configurations[best],
        mean=mean,
        sd=sd,
        interval_95=calibrated.interval_95(mean, sd),
        probability_best=candidates[0].probability_best,
        top=candidates,
        per_rock=[_rock_row(model, world, own, configurations[best], sign) for world in model.worlds],
        default_values=dict(default),
        default_mean=sign * float(belief.mean[reference]),
        default_sd=float(belief.sd[reference]),
        improvement=gain,
        improvement_sd=gain_sd,
        improvement_interval_95=calibrated.interval_95(gain, gain_sd),
        probability_better_than_default=calibrated.probability_positive(gain, gain_sd),
        noise_sd=model.noise_sd,
        block_sd=model.block_sd,
        observations=len(feasible),
        failures=len(observations) - len(feasible),
        metric=objective.metric,
        direction=objective.direction,
        lengthscales=model.lengthscales,
        leave_one_out=model.leave_one_out().to_dict(),
        calibration=calibrated.to_dict(),
        sparsest=simple,
        inactive=inactive,
        next_rock=elsewhere,
        limit=None if within is None else _second_objective(within, configurations[best], default, kept),
    )


def _second_objective(
    within: Within, values: Mapping[str, Any], default: Mapping[str, Any], kept: bool
) -> SecondObjective:
    means, sds = within.belief([values, default])
    (probability,) = within.probability([values])
    return SecondObjective(
        kept,
        float(means[0]),
        float(sds[0]),
        float(probability),
        within.at_least,
        float(means[1]),
        float(sds[1]),
    )


def _rock_row(
    model: RockMeanGP, world: World, own: Sequence[Observation], values: Mapping[str, Any], sign: float
) -> RockRow:
    outcomes = [o.outcome for o in own if o.world == world and o.outcome is not None]
    observed = sign * sum(outcomes) / len(outcomes) if outcomes else None
    predicted = sign * model.predict_in_world(values, world)
    return RockRow(world.rock, len(outcomes), observed, predicted, world.condition)
