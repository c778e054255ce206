"""Which configurations may be recommended: those that have flown often enough to be more than lucky once.

The best of many posterior means is too good more often than not: most of what the surrogate knows of a configuration that
flew once is what it concludes from neighbours, and a planner's outcome jumps wherever another view is chosen. So a
configuration has to have flown on two rocks and with two replicates. The default was chosen by hand, not by an outcome:
nothing flatters it.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any

from tuner.problem.configurations import Block, blocks_flown, configuration_key
from tuner.problem.observations import Observation
from tuner.problem.search_space import SearchSpace

ROCKS, REPLICATES = 2, 2


def enough(flown: Collection[Block], rocks: Collection[str], replicates: int) -> bool:
    """Whether these blocks are two training rocks and two replicates, or all of them where there are fewer."""
    own = [(rock, replicate) for rock, replicate in flown if rock in rocks]
    return len({rock for rock, _ in own}) >= min(ROCKS, len(rocks)) and len({k for _, k in own}) >= min(
        REPLICATES, replicates
    )


def may_be_recommended(
    space: SearchSpace,
    history: Sequence[Observation],
    configurations: Sequence[Mapping[str, Any]],
    rocks: Collection[str],
    replicates: int,
    default: Mapping[str, Any],
) -> list[bool]:
    """Of each configuration, after ``history``; ``replicates``: the campaign's, per rock."""
    flown = blocks_flown(space, [o for o in history if o.feasible])
    trusted = configuration_key(space, default)
    keys = [configuration_key(space, values) for values in configurations]
    return [key == trusted or enough(flown.get(key, ()), rocks, replicates) for key in keys]
