"""Flying the favourite once more before anybody recommends it.

The search flies a new configuration with every mission, so most of what it knows of its favourite is what the
surrogate concludes from neighbours. A planner's outcome jumps wherever another view is chosen, the surrogate takes it
for smooth, and the best of many such conclusions is too good more often than not. Near the end of a budget, when little
is left to gain by exploring, the favourite is therefore flown on the (rock, replicate) blocks it has not seen. What the
first such mission of a favourite falls short of its prediction by, on average, is what a configuration is marked down
by in a recommendation for the share of the blocks it has not flown. Later ones say nothing of what has flown once: they
are predicted from those before.

Blocks, not rocks: one that chooses the plateau's views on every rock once may lose half a point with the other replicate.
The last missions of a budget, as many as there are blocks, complete what would be recommended whatever exploring
promises: a newcomer that nobody can check any more is of no use to anybody.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np

from nbv.errors import UserError
from tuner.problem.blocks import next_block
from tuner.problem.configurations import Block, blocks_flown, configuration_key, distinct_configurations
from tuner.problem.observations import Observation, Pending, Proposal
from tuner.problem.options import Risk
from tuner.problem.search_space import SearchSpace, Values
from tuner.surrogate.model import RockMeanGP

BEGINS = 2 / 3  # of the search budget
# In the memory of a favourite's first verification mission: the mean predicted for it.
PREDICTED = "predicted"
# The model's noise counts like this many such missions that fell short by it.
PRIOR_MISSIONS = 1.0


def expected_shortfall(history: Sequence[Observation], noise_sd: float) -> float | None:
    """How far a favourite's first verification mission will stay behind its prediction; None before the first one.

    The mean over those so far and one made-up one that falls short by the noise of a mission; objective's unit,
    never negative. `UserError` where the ledger has something else than a prediction.
    """
    gaps = [_predicted(o) - o.outcome for o in history if PREDICTED in o.memory and o.outcome is not None]
    if not gaps:
        return None
    return max(0.0, (PRIOR_MISSIONS * noise_sd + sum(gaps)) / (PRIOR_MISSIONS + len(gaps)))


def _predicted(mission: Observation) -> float:
    value = mission.memory[PREDICTED]
    if isinstance(value, (int, float)) and math.isfinite(value):
        return float(value)
    raise UserError(
        f"the ledger says {value!r} was predicted for trial {mission.number}, which is no number; restore the ledger"
    )


def verification(
    model: RockMeanGP,
    history: Sequence[Observation],
    pending: Sequence[Pending],
    replicates: int,
    expected_gain: float,
    risk: Risk = "mean",
    *,
    last: bool = False,
    default: Mapping[str, Any] | None = None,
) -> Proposal | None:
    """The favourite on a block it has not flown, if that is worth more than exploring.

    Parameters
    ----------
    model
        The surrogate of the successful missions in ``history``.
    replicates
        Per rock, numbered from 0.
    expected_gain
        What the best mission of the search promises, objective's unit.
    last
        Whether to verify whatever exploring promises, and what would be recommended before the favourite.
    default
        The configuration that the campaign began with.

    Returns
    -------
    None where the favourite (best posterior mean) has flown every block, or where exploring promises more than it is
    expected to fall short by. The rock is one of those it has flown least.
    """
    shortfall = expected_shortfall(history, model.noise_sd)
    if shortfall is None:
        shortfall = model.noise_sd
    if shortfall <= expected_gain and not last:
        return None
    configurations = distinct_configurations(model.space, model.observations)
    mean = model.posterior(configurations, risk).mean
    candidates = [int(mean.argmax())]
    if last:
        cautious = mean - markdown(model.space, history, configurations, model.rocks, shortfall, default)
        candidates.insert(0, int(cautious.argmax()))
    missions: list[Observation | Pending] = [*history, *pending]
    flown = blocks_flown(model.space, missions)
    for i in candidates:
        values = configurations[i]
        own = flown[configuration_key(model.space, values)]
        block = _unseen_block(model.rocks, replicates, own, missions, values)
        if block is None:
            continue
        predicted, sd = model.predict_mission(values, *block)
        why = {
            "sampler": "gp", "phase": "verification", "predicted_mean": predicted, "predicted_sd": sd,
            "expected_shortfall": shortfall, "expected_gain": expected_gain,
        }  # fmt: skip
        return Proposal(values, why, *block, memory={PREDICTED: predicted} if len(own) <= 1 else {})
    return None


def _unseen_block(
    rocks: Sequence[str],
    replicates: int,
    own: Collection[Block],
    missions: Sequence[Observation | Pending],
    values: Values,
) -> Block | None:
    """The next block of a configuration that has flown ``own``, on a rock it has flown least; None if there is none."""
    counts = {rock: sum((rock, k) in own for k in range(replicates)) for rock in rocks}
    least = min(counts.values())
    if least >= replicates:
        return None
    fewest = [rock for rock, count in counts.items() if count == least]
    return next_block(fewest, replicates, missions, Proposal(values, {}))


def markdown(
    space: SearchSpace,
    history: Sequence[Observation],
    configurations: Sequence[Mapping[str, Any]],
    rocks: Sequence[str],
    shortfall: float | None,
    default: Mapping[str, Any] | None = None,
) -> np.ndarray:
    """(len(configurations),) what each loses in a recommendation: ``shortfall`` for its share of unseen blocks.

    Blocks are those of ``rocks`` that any configuration has flown. ``default`` loses nothing: no outcome made it a
    favourite, so nothing flatters it, and nothing believed to be worse may be recommended in its place.
    """
    if shortfall is None:
        return np.zeros(len(configurations))
    blocks = {(o.rock, o.replicate) for o in history if o.rock in rocks}
    flown, keys = blocks_flown(space, history), [configuration_key(space, c) for c in configurations]
    trusted = None if default is None else configuration_key(space, default)
    unseen = [0 if key == trusted else len(blocks - flown[key]) for key in keys]
    return shortfall * np.array(unseen) / len(blocks)
