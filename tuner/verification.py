"""Flying the favourite once more before anybody recommends it.

The search flies a new configuration with every mission, so most of what it knows of its favourite is what the
surrogate concludes from neighbours. A planner's outcome jumps wherever another view is chosen, the surrogate takes it
for smooth, and the best of many such conclusions is too good more often than not. Near the end of a budget, when little
is left to gain by exploring, the favourite is therefore flown on a (rock, replicate) slot it has not seen; what such
missions fall short of the prediction by, on average, is what a configuration is marked down by in a recommendation for
the share of the slots it has not flown.

Slots, not rocks: one that chooses the plateau's views on every rock once may lose half a point with the other replicate.
The last missions of a budget, as many as there are slots, are the favourite's whatever exploring promises: a newcomer
that nobody can check any more is of no use to anybody.
"""

from __future__ import annotations

import collections
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from nbv.errors import UserError
from tuner.gp_options import Risk
from tuner.history import Observation, Pending, Proposal
from tuner.search_space import SearchSpace
from tuner.slots import next_slot
from tuner.surrogate import RockMeanGP

BEGINS = 2 / 3  # of the search budget
PREDICTED = "predicted"  # in the memory of a verification mission: the mean that was predicted for it
# The model's noise counts like this many verification missions that fell short by it.
PRIOR_MISSIONS = 1.0

Key = tuple[float, ...]
Slot = tuple[str, int]  # rock, replicate


def configuration_key(space: SearchSpace, values: Mapping[str, Any]) -> Key:
    """The same for the same configuration."""
    return tuple(round(float(u), 12) for u in space.to_unit(values))


def slots_flown(space: SearchSpace, missions: Sequence[Observation | Pending]) -> dict[Key, set[Slot]]:
    """The (rock, replicate) slots that each configuration has flown, or is flying."""
    flown: dict[Key, set[Slot]] = collections.defaultdict(set)
    for mission in missions:
        flown[configuration_key(space, mission.values)].add((mission.rock, mission.replicate))
    return flown


def expected_shortfall(history: Sequence[Observation], noise_sd: float) -> float | None:
    """How far the next verification mission will stay behind its prediction; None before the first one.

    The mean over the verification missions so far and one made-up one that falls short by the noise of a mission;
    objective's unit, never negative. `UserError` where the ledger has something else than a prediction.
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
) -> Proposal | None:
    """The favourite on a slot it has not flown, if that is worth more than exploring.

    Parameters
    ----------
    model
        The surrogate of the successful missions in ``history``.
    replicates
        Per rock, numbered from 0.
    expected_gain
        What the best mission of the search promises, objective's unit.
    last
        Whether to verify whatever exploring promises.

    Returns
    -------
    None where the favourite (best posterior mean) has flown every slot, or where exploring promises more than
    verification missions are expected to fall short by. The rock is one of those it has flown least.
    """
    shortfall = expected_shortfall(history, model.noise_sd)
    if shortfall is None:
        shortfall = model.noise_sd
    if shortfall <= expected_gain and not last:
        return None
    seen = {configuration_key(model.space, o.values): o.values for o in model.observations}
    configurations = list(seen.values())
    favourite = dict(configurations[int(model.posterior(configurations, risk).mean.argmax())])
    missions: list[Observation | Pending] = [*history, *pending]
    flown = slots_flown(model.space, missions)[configuration_key(model.space, favourite)]
    counts = {rock: sum((rock, k) in flown for k in range(replicates)) for rock in model.rocks}
    least = min(counts.values())
    if least >= replicates:
        return None
    rocks = [rock for rock, count in counts.items() if count == least]
    rock, replicate = next_slot(rocks, replicates, missions, Proposal(favourite, {}))
    predicted, sd = model.predict_mission(favourite, rock, replicate)
    why = {
        "sampler": "gp", "phase": "verification", "predicted_mean": predicted, "predicted_sd": sd,
        "expected_shortfall": shortfall, "expected_gain": expected_gain,
    }  # fmt: skip
    return Proposal(favourite, why, rock, replicate, {PREDICTED: predicted})


def markdown(
    space: SearchSpace,
    history: Sequence[Observation],
    configurations: Sequence[Mapping[str, Any]],
    rocks: Sequence[str],
    shortfall: float | None,
) -> np.ndarray:
    """(len(configurations),) what each loses in a recommendation: ``shortfall`` for its share of unseen slots.

    Slots are those of ``rocks`` that any configuration has flown.
    """
    if shortfall is None:
        return np.zeros(len(configurations))
    slots = {(o.rock, o.replicate) for o in history if o.rock in rocks}
    flown = slots_flown(space, history)
    unseen = [len(slots - flown[configuration_key(space, values)]) for values in configurations]
    return shortfall * np.array(unseen) / len(slots)
