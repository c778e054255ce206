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

from tuner.acquisition.constrained import Constraint
from tuner.problem.observations import (
    Observation,
    Proposal,
    blocks_evaluated,
    configuration_key,
    distinct_configurations,
    next_block,
)
from tuner.recommendation.choose import JOINT, TOP
from tuner.surrogate.model import InstanceMeanGP


def verification(
    model: InstanceMeanGP,
    history: Sequence[Observation],
    pending: Sequence[Observation],
    replicates: int,
    expected_gain: float,
    *,
    last: bool = False,
    constraint: Constraint | None = None,
) -> Proposal | None:
    """Return the favourite on a block that it has not run, in an instance that it has run least; None where exploring is worth more.

    ``model``: of the objective. ``replicates``: per instance, numbered from 0.
    ``expected_gain``: what the best mission of the search promises, objective's unit; infinite where that is
    not known. ``last``: whether to verify whatever exploring promises.

    The favourite has the best posterior mean, and exploring is worth more where it promises more than the noise of a mission.
    """
    if expected_gain >= model.noise_sd and not last:
        return None
    configurations = distinct_configurations(model.space, model.observations)
    if constraint is not None:
        configurations = [v for v, keeps in zip(configurations, constraint.keeps(configurations)) if keeps]
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
