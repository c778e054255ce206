"""Running the favourite once more before it is recommended.

The search runs a new configuration with every mission, and one that ran once may not be recommended
(``tuner.recommendation.choose``). Near the end of a budget, when exploring promises less than a mission's noise, the
favourite is therefore run on the (instance, replicate) blocks it has not seen; the last missions, as many as rocks
have replicates, are the favourite's whatever exploring promises.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import torch

from tuner.acquisition.constrained import Constraint, ObjectiveModel, surrogate_of
from tuner.acquisition.expected_saving import LogExpectedSaving
from tuner.problem.observations import (
    Observation,
    Proposal,
    blocks_evaluated,
    configuration_key,
    distinct_configurations,
    next_block,
)
from tuner.problem.search_space import Values
from tuner.recommendation.choose import JOINT, TOP, enough
from tuner.surrogate.model import InstanceMeanGP
from tuner.surrogate.posterior import DeterministicOutcome


def verification(
    models: Sequence[ObjectiveModel],
    history: Sequence[Observation],
    pending: Sequence[Observation],
    replicates: int,
    expected_gain: float,
    *,
    last: bool = False,
    constraint: Constraint | None = None,
) -> Proposal | None:
    """Return the favourite on a block that it has not run, in an instance that it has run least; None where exploring is worth more.

    ``models``: of the objective and, under a ``constraint``, of the second one. ``replicates``: per instance, numbered from 0.
    ``expected_gain``: what the best mission of the search promises, objective's unit; infinite where that is
    not known. ``last``: whether to verify whatever exploring promises.

    The favourite has the best posterior mean, and exploring is worth more where it promises more than the noise of a mission. Where
    the objective is a deterministic metric it is the configuration whose mission has the largest expected saving, if that is more
    than exploring promises.
    """
    model, exact = surrogate_of(models), models[0]
    if constraint is not None and isinstance(exact, DeterministicOutcome):
        chosen = _worth_confirming(model, history, pending, replicates, constraint, exact)
        if chosen is None or (expected_gain > chosen[1] and not last):
            return None
        values = chosen[0]
    else:
        if expected_gain >= model.noise_sd and not last:
            return None
        configurations = distinct_configurations(model.space, model.observations)
        if constraint is not None:
            configurations = [
                v for v, keeps in zip(configurations, constraint.keeps(configurations)) if keeps
            ]
            if not configurations:
                return None
        if len(configurations) > JOINT:
            configurations = [configurations[i] for i in model.best_first(configurations)[:TOP]]
        values = configurations[int(model.posterior(configurations).mean.argmax())]
    missions: list[Observation] = [*history, *pending]
    ran = blocks_evaluated(model.space, missions)[configuration_key(model.space, values)]
    counts = {instance: sum((instance, k) in ran for k in range(replicates)) for instance in model.instances}
    least = min(counts.values())
    if least >= replicates:
        return None
    fewest = [instance for instance, count in counts.items() if count == least]
    why = {"expected_gain": expected_gain} if math.isfinite(expected_gain) else {}
    proposal = Proposal(values, {"sampler": "gp", "phase": "verification", **why})
    instance, replicate = next_block(fewest, replicates, missions, proposal)
    return dataclasses.replace(proposal, instance=instance, replicate=replicate)


def _worth_confirming(
    model: InstanceMeanGP,
    history: Sequence[Observation],
    pending: Sequence[Observation],
    replicates: int,
    constraint: Constraint,
    exact: DeterministicOutcome,
) -> tuple[Values, float] | None:
    """Return the configuration run that one mission more may save most by, and how much it is expected to save.

    Against the cheapest that may be recommended already and is taken to meet the constraint: that one where nothing is cheaper.
    """
    configurations = distinct_configurations(model.space, model.observations)
    costs, keeps = exact.posterior(configurations).mean, constraint.keeps(configurations)
    succeeded = blocks_evaluated(model.space, model.observations)
    evaluated = blocks_evaluated(model.space, [*history, *pending])
    keys = [configuration_key(model.space, values) for values in configurations]
    done = [
        i for i, key in enumerate(keys) if keeps[i] and enough(succeeded[key], model.instances, replicates)
    ]
    best = max((costs[i] for i in done), default=costs.min() - 1.0)
    open_ = [
        i
        for i, key in enumerate(keys)
        if costs[i] > best and len(evaluated[key]) < replicates * len(model.instances)
    ]
    if not open_:
        favourite = max(done, key=lambda i: costs[i], default=None)
        return None if favourite is None else (configurations[favourite], 0.0)
    x = model.inputs_at([configurations[i] for i in open_])
    running = model.inputs_at([p.values for p in pending]) if pending else None
    value = LogExpectedSaving(model, exact, constraint.at_least, constraint.quantile, float(best), running)
    with torch.no_grad():
        scores = value(x.unsqueeze(1))
    chosen = int(scores.argmax())
    return configurations[open_[chosen]], float(scores[chosen].exp())
