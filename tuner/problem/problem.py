"""What a campaign tunes, behind one interface: missions over rocks, or a mission of the user's own.

The first is `tuner.campaign.rock_problem.RockProblem`, the second `tuner.missions.external.problem.MissionFileProblem`. What
differs between the two is a method here, so that no other code asks which one it is.
"""

from __future__ import annotations

import abc
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from nbv.config import IDEAL, Condition
from tuner.problem.deterministic_metrics import DeterministicMetric
from tuner.problem.objective import Objective
from tuner.problem.search_space import Configuration, Values


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


class Problem(abc.ABC):
    """Instances, default, baselines, how a trial runs, and how it is shown."""

    instance_word: str  # what missions run on: "rock" or "instance"
    code_word: str  # what may change between two sessions: "code" or "program"
    reference: str  # the baseline that differences are from

    # -- configurations --------------------------------------------------------------------------------------

    @abc.abstractmethod
    def base_config(self) -> Configuration:
        """Return the configuration on which conditions and tuned values are laid."""

    @abc.abstractmethod
    def default_values(self) -> Values:
        """Return the values at which every sampler starts."""

    @abc.abstractmethod
    def config(self, values: Mapping[str, Any], condition: str = IDEAL) -> Configuration:
        """Return the configuration at tuned ``values`` under a condition; ``UserError`` where there is none."""

    @abc.abstractmethod
    def deterministic_metric(self, objective: Objective) -> DeterministicMetric | None:
        """Return the objective as a function of the tuned values; None where only a mission can tell it."""

    def arms(self) -> dict[str, Values]:
        """Return the plain plans that a campaign runs beside what it searches, by strategy; the default is one of them."""
        return {self.reference: self.default_values()}

    # -- what may be asked -----------------------------------------------------------------------------------

    @abc.abstractmethod
    def check_instances(self, rocks: Sequence[str]) -> None:
        """Raise `UserError` where a campaign cannot be tuned on ``rocks``."""

    def check_limit(self, limited: Objective, limit: float) -> None:  # noqa: B027  most limits are possible
        """Raise `UserError` where nothing can meet the constraint, or where it cannot be shown that it is kept."""

    # -- how a trial runs ------------------------------------------------------------------------------------

    @abc.abstractmethod
    def fidelity(self, asked: str) -> str:
        """Return the fidelity of an evaluation; ``UserError`` where the one ``asked`` for does not go with the problem."""

    @abc.abstractmethod
    def code(self) -> str:
        """Return the digest of what runs a mission."""

    @abc.abstractmethod
    def photographs(self, values: Mapping[str, Any]) -> int:
        """Return how many photographs a mission takes at most; 0 where that is not known before it runs."""

    def require_named(self, named: bool) -> None:  # noqa: B027  code of this program needs no trust
        """Raise `UserError` where missions run a program that the user has not ``named``: a run directory may be anybody's."""

    def require_measured(  # noqa: B027  what missions of this program measure is known before
        self, objectives: Sequence[Objective], measured: Mapping[str, Any]
    ) -> None:
        """Raise `UserError` where a first mission has ended without a metric that it is tuned for."""

    # -- what it is compared with ----------------------------------------------------------------------------

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

    # -- how it is shown -------------------------------------------------------------------------------------

    @abc.abstractmethod
    def provenance(self) -> tuple[str, str]:
        """Return what configurations are made from, and its name."""

    def options(self) -> list[str]:
        """Return the options of commands that run missions which a settings file may not replace."""
        return []

    @abc.abstractmethod
    def can_run(self, values: Mapping[str, Any]) -> bool:
        """Return whether a wider search space may contain ``values``."""
