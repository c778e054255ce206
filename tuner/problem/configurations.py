"""Which missions flew the same configuration, and on which blocks."""

from __future__ import annotations

import collections
from collections.abc import Mapping, Sequence
from typing import Any

from tuner.problem.observations import Observation, Pending
from tuner.problem.search_space import SearchSpace, Values
from tuner.problem.worlds import World

Key = tuple[float, ...]
Block = tuple[World, int]  # with the replicate


def configuration_key(space: SearchSpace, values: Mapping[str, Any]) -> Key:
    """The same for the same configuration."""
    return tuple(round(float(u), 12) for u in space.to_unit(values))


def distinct_configurations(space: SearchSpace, missions: Sequence[Observation]) -> list[Values]:
    """Return each configuration that has flown, once, in the order of the first missions."""
    return [dict(v) for v in {configuration_key(space, o.values): o.values for o in missions}.values()]


def blocks_flown(space: SearchSpace, missions: Sequence[Observation | Pending]) -> dict[Key, set[Block]]:
    """The (world, replicate) blocks that each configuration has flown, or is flying."""
    flown: dict[Key, set[Block]] = collections.defaultdict(set)
    for mission in missions:
        flown[configuration_key(space, mission.values)].add((mission.world, mission.replicate))
    return flown


def short(value: Any) -> str:
    """A parameter's value as a person writes it: four significant digits."""
    return f"{value:.4g}" if isinstance(value, float) else str(value)
