"""What a trial is: all that a search knows of it (`Problem`), and how it runs (`MissionProblem`).

What differs between `tuner.campaign.rock_problem.RockProblem` and `tuner.missions.external.problem.MissionFileProblem` is a
method here, so that no other code asks which one it is.
"""

from __future__ import annotations

import abc
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from nbv.config import IDEAL, Condition
from tuner.problem.instances import Instance, are_drawn, rocks_of, training_rock
from tuner.problem.objective import Objective
from tuner.problem.search_space import Configuration, SearchSpace, Values


class Strategies(NamedTuple):
    """What is run against each other, by name, and what a reader of the outcome must know of it."""

    configs: Mapping[str, Configuration]
    notes: tuple[str, ...] = ()


class Evaluated(NamedTuple):
    """A recommendation, and what it is evaluated on."""

    values: Mapping[str, Any]
    photographs: int | None  # that it took, mean over its missions rounded up; None where it has none
    conditions: Sequence[Condition]
    rocks: Sequence[str]


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


@dataclass(frozen=True, kw_only=True)
class MissionProblem(Problem, abc.ABC):
    """How a trial runs, what it is compared with, and how it is shown."""

    base: Configuration  # on which conditions and tuned values are laid
    seed: int = 0  # of the rocks that are drawn

    instance_word = "rock"  # what missions run on: "rock" or "instance"
    code_word = "code"  # what may change between two sessions: "code" or "program"
    reference = ""  # the baseline that differences are from

    @abc.abstractmethod
    def config(self, values: Mapping[str, Any], condition: str = IDEAL) -> Configuration:
        """Return the configuration at tuned ``values`` under a condition; ``UserError`` where there is none."""

    def drawn_rock(self, rock: str, replicate: int) -> str:
        """Return the rock of a mission: ``rock`` itself or, of a family, the one drawn for this replicate."""
        return training_rock(rock, replicate, self.seed)

    def check_limit(self, limited: Objective, limit: float) -> None:
        """Raise `UserError` where nothing can meet the constraint."""

    def fidelity(self, name: str) -> str:
        """Return the fidelity of an evaluation; ``UserError`` where the one asked for by ``name`` does not go with the problem."""
        return name

    @abc.abstractmethod
    def code(self) -> str:
        """Return the digest of what runs a mission."""

    def require_named(self, named: bool) -> None:
        """Raise `UserError` where missions run a program that the user has not ``named``: a run directory may be anybody's."""

    def require_measured(self, objectives: Sequence[Objective], measured: Mapping[str, Any]) -> None:
        """Raise `UserError` where a first mission has ended without a metric that it is tuned for."""

    @abc.abstractmethod
    def held_out(self) -> tuple[str, ...]:
        """Return the instances that a campaign may not tune on and an evaluation runs by default."""

    @abc.abstractmethod
    def evaluated_on(self, rocks: Sequence[str] | None, replicates: int) -> tuple[tuple[str, ...], int]:
        """Return the instances of an evaluation, looked up, and its replicates; ``rocks``: those that the user named."""

    @abc.abstractmethod
    def strategies(self, tuned: Evaluated, names: Sequence[str] | None) -> Strategies:
        """Return the recommendation and the baselines ``names`` beside it; None: those that are run by default."""

    def controls(self, tuned: Evaluated) -> Strategies:
        """Return what tells a gain from chance where the recommendation is confirmed."""
        return Strategies({})

    def options(self) -> list[str]:
        """Return the options of commands that run missions which a settings file may not replace."""
        return []

    @abc.abstractmethod
    def can_run(self, values: Mapping[str, Any]) -> bool:
        """Return whether a wider search space may contain ``values``."""
