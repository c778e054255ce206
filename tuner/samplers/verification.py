"""Flying the favourite once more before anybody recommends it.

The search flies a new configuration with every mission, and one that flew once may not be recommended
(``tuner.recommendation.eligible``). Near the end of a budget, when exploring promises less than a mission's noise, the
favourite is therefore flown on the (world, replicate) blocks it has not seen; the last missions, as many as rocks
have replicates, are the favourite's whatever exploring promises.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from tuner.acquisition.within import Within
from tuner.problem.blocks import next_block
from tuner.problem.configurations import Block, blocks_flown, configuration_key, distinct_configurations
from tuner.problem.observations import Observation, Pending, Proposal
from tuner.problem.options import Risk
from tuner.problem.search_space import Values
from tuner.problem.worlds import World
from tuner.recommendation.choose import JOINT, TOP
from tuner.surrogate.known import KnownOutcome
from tuner.surrogate.model import RockMeanGP

BEGINS = 2 / 3  # of the budget
WORTH = 0.01  # of an exact cost: less is not worth a mission of the search


def verification(
    model: RockMeanGP,
    history: Sequence[Observation],
    pending: Sequence[Pending],
    replicates: int,
    expected_gain: float,
    risk: Risk = "mean",
    *,
    last: bool = False,
    within: Within | None = None,
    exact: KnownOutcome | None = None,
) -> Proposal | None:
    """The favourite on a block it has not flown, if that is worth more than exploring.

    Parameters
    ----------
    model
        The surrogate of the successful missions in ``history``.
    replicates
        Per world, numbered from 0.
    expected_gain
        What the best mission of the search promises, objective's unit.
    last
        Whether to verify whatever exploring promises.
    within
        A limit that the favourite has to keep.
    exact
        The objective, where the configuration decides it: the favourite is then the cheapest.

    Returns
    -------
    None where the favourite (best posterior mean) has flown every block, or where exploring promises more than the noise
    of a mission, or than `WORTH` of an exact cost. The world is one of those it has flown least.
    """
    if exact is None and expected_gain >= model.noise_sd and not last:
        return None
    configurations = distinct_configurations(model.space, model.observations)
    if within is not None:
        configurations = [v for v, kept in zip(configurations, within.keeps(configurations)) if kept]
        if not configurations:
            return None
    if len(configurations) > JOINT:
        known = None if exact is None else (-exact.posterior(configurations).mean).argsort(kind="stable")
        order = model.best_first(configurations, risk) if known is None else known.tolist()
        configurations = [configurations[i] for i in order[:TOP]]
    quality = model.posterior(configurations, risk).mean
    if exact is None:
        values = configurations[int(quality.argmax())]
    else:
        costs = exact.posterior(configurations).mean
        favourite = int(np.lexsort((-quality, -costs))[0])
        if expected_gain >= WORTH * abs(costs[favourite]) and not last:
            return None
        values = configurations[favourite]
    missions: list[Observation | Pending] = [*history, *pending]
    own = blocks_flown(model.space, missions)[configuration_key(model.space, values)]
    block = _unseen_block(model.worlds, replicates, own, missions, values)
    why = {"sampler": "gp", "phase": "verification", "expected_gain": expected_gain}
    if block is None:
        return None
    world, replicate = block
    return Proposal(values, why, world.rock, replicate, condition=world.condition)


def _unseen_block(
    worlds: Sequence[World],
    replicates: int,
    own: Collection[Block],
    missions: Sequence[Observation | Pending],
    values: Values,
) -> Block | None:
    """The next block of a configuration that has flown ``own``, in a world it has flown least; None if there is none."""
    counts = {world: sum((world, k) in own for k in range(replicates)) for world in worlds}
    least = min(counts.values())
    if least >= replicates:
        return None
    fewest = [world for world, count in counts.items() if count == least]
    return next_block(fewest, replicates, missions, Proposal(values, {}))
