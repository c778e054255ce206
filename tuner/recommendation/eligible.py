"""Which configurations may be recommended: those that have flown often enough to be more than lucky once.

The best of many posterior means is too good more often than not: most of what the surrogate knows of a configuration that
flew once is what it concludes from neighbours, and a planner's outcome jumps wherever another view is chosen. So a
configuration has to have flown on two rocks and with two replicates, and where there are several conditions under two. The default was chosen by hand, not by an outcome:
nothing flatters it.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any

from tuner.problem.configurations import Block, blocks_flown, configuration_key
from tuner.problem.observations import Observation
from tuner.problem.search_space import SearchSpace
from tuner.problem.worlds import Place, conditions_of, rocks_of, worlds_of

ROCKS, CONDITIONS, REPLICATES = 2, 2, 2


def enough(flown: Collection[Block], places: Collection[Place], replicates: int) -> bool:
    """Return whether these blocks cover two training rocks, conditions and replicates, or all where there are fewer."""
    worlds = worlds_of(places)
    own = [(world, replicate) for world, replicate in flown if world in worlds]
    seen = [world for world, _ in own]
    return (
        len(rocks_of(seen)) >= min(ROCKS, len(rocks_of(worlds)))
        and len(conditions_of(seen)) >= min(CONDITIONS, len(conditions_of(worlds)))
        and len({k for _, k in own}) >= min(REPLICATES, replicates)
    )


def may_be_recommended(
    space: SearchSpace,
    history: Sequence[Observation],
    configurations: Sequence[Mapping[str, Any]],
    places: Collection[Place],
    replicates: int,
    default: Mapping[str, Any],
) -> list[bool]:
    """Return for each configuration whether it has flown often enough; the default always has.

    Parameters
    ----------
    space
        The search space.
    history
        Finished missions; only feasible ones count.
    configurations
        The configurations in question.
    places
        The training worlds.
    replicates
        The campaign's replicates per world.
    default
        The default values.
    """
    flown = blocks_flown(space, [o for o in history if o.feasible])
    trusted = configuration_key(space, default)
    keys = [configuration_key(space, values) for values in configurations]
    return [key == trusted or enough(flown.get(key, ()), places, replicates) for key in keys]
