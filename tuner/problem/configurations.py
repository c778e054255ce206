"""Which missions flew the same configuration, and on which blocks."""

from __future__ import annotations

import collections
from collections.abc import Mapping, Sequence
from typing import Any

from nbv.config import MissionConfig, parameters
from tuner.problem.observations import Observation, Pending
from tuner.problem.search_space import Configuration, SearchSpace, Values
from tuner.problem.worlds import World

Key = tuple[float, ...]
Block = tuple[World, int]  # with the replicate
# What only the planner of a mission reads: without effect where no view is planned.
PLANNERS = (
    *("gate.", "covis.", "b_aware.", "matchable."),
    *("pool.min_altitude_m", "pool.max_altitude_m", "pool.max_travel_m", "pool.min_spacing_m"),
    *("pool.revisit_exclusion_m", "pool.azimuth_sectors", "pool.max_candidates"),
)


def configuration_key(space: SearchSpace, values: Mapping[str, Any]) -> Key:
    """Return what is the same for equal configurations, and for no others."""
    return tuple(round(float(u), 12) for u in space.to_unit(values))


def distinct_configurations(space: SearchSpace, missions: Sequence[Observation]) -> list[Values]:
    """Return each configuration that has flown, once, in the order of the first missions."""
    return [dict(v) for v in {configuration_key(space, o.values): o.values for o in missions}.values()]


def blocks_flown(space: SearchSpace, missions: Sequence[Observation | Pending]) -> dict[Key, set[Block]]:
    """Return the (world, replicate) blocks that each configuration has flown, or is flying."""
    flown: dict[Key, set[Block]] = collections.defaultdict(set)
    for mission in missions:
        flown[configuration_key(space, mission.values)].add((mission.world, mission.replicate))
    return flown


def changes(values: Mapping[str, Any], default: Mapping[str, Any]) -> tuple[str, ...]:
    """Paths whose values differ from the default's, less those that are without effect."""
    idle = PLANNERS if values.get("stop.adaptive_budget") == 0 else ()
    return tuple(
        path for path, value in values.items() if value != default[path] and not path.startswith(idle)
    )


def mission_key(config: Configuration) -> str:
    """Return the same for configurations that fly the same mission: what is without effect in it does not count."""
    if isinstance(config, MissionConfig) and config.adaptive_budget == 0:
        idle = {path: about.default for path, about in parameters().items() if path.startswith(PLANNERS)}
        config = config.with_values(idle)
    return config.digest()


def short(value: Any) -> str:
    """Return a parameter's value as a person writes it: four significant digits."""
    return f"{value:.4g}" if isinstance(value, float) else str(value)
