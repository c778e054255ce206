"""Missions as plain values: finished ones, those in flight, what is proposed; which configurations ran on which blocks."""

from __future__ import annotations

import collections
import functools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from nbv.cache import digest
from nbv.config import IDEAL, MissionConfig, parameters
from tuner.problem.instances import Instance
from tuner.problem.search_space import PHOTOGRAPHS, PLANNERS, SEEDS, SearchSpace, Values

MAX_MISSIONS = 100_000  # of a campaign
MAX_REPLICATES = 10_000  # of a rock
Key = tuple[float, ...]
Block = tuple[Instance, int]  # with the replicate


@dataclass(frozen=True)
class Observation:
    """One mission as samplers see it, finished or in flight: one configuration on one rock with one replicate."""

    number: int  # trial number in the ledger
    values: Mapping[str, Any]  # tuned parameters by path
    rock: str
    replicate: int
    # Oriented so that larger is better; None: in flight, or failed, i.e. infeasible.
    outcome: float | None = None
    raw: float | None = None  # the metric as measured
    reason: str = ""  # why it failed, in snake_case: "worker_died: SIGABRT", "timeout", "seed_model_failed"
    # Outcome of a second objective, oriented alike; None: none asked for, or missing.
    second: float | None = None
    condition: str = IDEAL  # its name
    repeat: bool = False  # its photographs are those of an earlier trial: it costs no budget

    @property
    def feasible(self) -> bool:
        """Whether the mission produced the objective's metric."""
        return self.outcome is not None

    @functools.cached_property
    def instance(self) -> Instance:
        return Instance(self.rock, self.condition)


@dataclass(frozen=True)
class Proposal:
    """What to run next; the campaign's schedule decides ``instance`` and ``replicate`` where they are None."""

    values: dict[str, Any]
    metadata: dict[str, Any]  # JSON: at least {"sampler": ..., "phase": ...}
    instance: Instance | None = None
    replicate: int | None = None


def next_block(
    instances: Sequence[Instance], replicates: int, missions: Sequence[Observation], proposal: Proposal
) -> tuple[Instance, int]:
    """Return the instance and the replicate of the next mission where the sampler left them open.

    The instance visited least (ties: list order), so instances are taken in turn; in it the replicate used least among
    those this configuration has not run there. A configuration that has run them all gets a fresh number.
    """
    if proposal.instance is not None and proposal.replicate is not None:
        return proposal.instance, proposal.replicate
    visits = collections.Counter(t.instance for t in missions)
    instance = proposal.instance or min(instances, key=lambda each: visits[each])
    if proposal.replicate is not None:
        return instance, proposal.replicate
    here = [t for t in missions if t.instance == instance]
    used = collections.Counter(t.replicate for t in here)
    taken = {t.replicate for t in here if t.values == proposal.values}
    fresh = [k for k in range(replicates) if k not in taken]
    if fresh:
        return instance, min(fresh, key=lambda k: (used[k], k))
    return instance, next(k for k in range(replicates, replicates + len(taken) + 1) if k not in taken)


def configuration_key(space: SearchSpace, values: Mapping[str, Any]) -> Key:
    """Return what is the same for equal configurations, and for no others."""
    return tuple(round(float(u), 12) for u in space.to_unit(values))


def distinct_configurations(space: SearchSpace, missions: Sequence[Observation]) -> list[Values]:
    """Return each configuration that has run, once, in the order of the first missions."""
    return [dict(v) for v in {configuration_key(space, o.values): o.values for o in missions}.values()]


def blocks_evaluated(space: SearchSpace, missions: Sequence[Observation]) -> dict[Key, set[Block]]:
    """Return the (instance, replicate) blocks that each configuration has run, or is running."""
    evaluated: dict[Key, set[Block]] = collections.defaultdict(set)
    for mission in missions:
        evaluated[configuration_key(space, mission.values)].add((mission.instance, mission.replicate))
    return evaluated


def changes(values: Mapping[str, Any], default: Mapping[str, Any]) -> tuple[str, ...]:
    """Paths whose values differ from the default's, less those that are without effect."""
    idle = PLANNERS if SEEDS in values and values[SEEDS] == values.get(PHOTOGRAPHS) else ()
    return tuple(
        path for path, value in values.items() if value != default[path] and not path.startswith(idle)
    )


def mission_key(config: MissionConfig) -> str:
    """Return the same for configurations that run the same mission: what is without effect in it does not count."""
    return (config if config.planned_views else _unplanned(config)).digest()


def _unplanned(config: MissionConfig) -> MissionConfig:
    """``config`` with the default of all that only decides which views are planned, or when planning ends, and none planned."""
    idle = (*PLANNERS, "stop.")
    defaults = {path: about.default for path, about in parameters().items() if path.startswith(idle)}
    return config.with_values(defaults).changed(plugins=(), photographs=config.seeds)


def photographs_key(config: MissionConfig, chosen: Sequence[str]) -> str:
    """Return the same for missions on one block that take the same photographs and use them alike.

    ``config``: of the mission. ``chosen``: the planned views, in order, by their names in the candidate pool.
    """
    return digest(_unplanned(config).digest(), list(chosen))


def short(value: Any) -> str:
    """Return a parameter's value as a person writes it: four significant digits."""
    return f"{value:.4g}" if isinstance(value, float) else str(value)
