"""What a search knows of its trials; `tuner.campaign.mission_problem.MissionProblem` knows how they run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from tuner.problem.instances import Instance, are_drawn, rocks_of
from tuner.problem.regions import TUNED, Region
from tuner.problem.search_space import SearchSpace, Values


@dataclass(frozen=True)
class Problem:
    """A trial is a configuration of ``space`` in one of the ``instances`` with one of the ``replicates``.

    This is all that samplers, the surrogate and the recommendation know of it.
    """

    space: SearchSpace
    instances: tuple[Instance, ...]  # training instances
    default: Values  # the configuration that everything starts from
    replicates: int = 1  # per instance
    # The plain plans that run beside what is searched, by strategy, the simplest first; the default is one of them.
    arms: Mapping[str, Values] = field(default_factory=dict)
    regions: tuple[Region, ...] = ()  # whose best configurations are asked for

    @property
    def answers(self) -> tuple[Region, ...]:
        """The regions; without one all of the space."""
        return self.regions or (Region(TUNED, self.space),)

    @property
    def rocks(self) -> tuple[str, ...]:
        return rocks_of(self.instances)

    @property
    def draws_rocks(self) -> bool:
        """Whether every mission meets a fresh rock of a family."""
        return are_drawn(self.rocks)

    @property
    def repeatable(self) -> tuple[Instance, ...]:
        """The instances in which a mission repeats exactly: no outcome is an outlier there."""
        return ()
