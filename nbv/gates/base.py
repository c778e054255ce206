"""What a gate is: it reads the state and returns one ranking to fly, unchanged (a hard switch)."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar, Self

from nbv.config import MissionConfig
from nbv.gates.truth import Oracle
from nbv.types import CandidatePool, GateDecision, PlanningState, Ranking


@dataclass(frozen=True)
class GateInputs:
    """What a gate may be made from."""

    config: MissionConfig
    rock_sha256: str = ""  # with the replicate, the key of a gate's random stream
    replicate: int = 0
    oracle: Oracle | None = None

    @property
    def truth(self) -> Oracle:
        """The ground truth: for a gate that says ``sees_ground_truth``, and for no other."""
        if self.oracle is None:
            raise ValueError("a gate that reads the ground truth must say sees_ground_truth = True")
        return self.oracle


class Gate(ABC):
    """Chooses the ranking to fly.

    A control or a planner of its own returns a ranking that is not among those given, under its own name, so that
    the mission loop is the same for all. A gate that draws (`nbv.gates.controls.RandomGate`) draws from a stream
    keyed by rock, replicate and iteration.
    """

    sees_ground_truth: ClassVar[bool] = False  # True: an upper reference, not deployable

    @classmethod
    def make(cls, given: GateInputs) -> Self:
        """The gate that a configuration asks for; here, for gates with nothing to set."""
        return cls()

    def retargeted(self, config: MissionConfig) -> Gate:
        """This gate, or one like it, once the target has been found where ``config`` says."""
        return self

    @abstractmethod
    def decide(self, state: PlanningState, pool: CandidatePool, rankings: dict[str, Ranking]) -> GateDecision:
        """The decision for one iteration.

        Parameters
        ----------
        pool
            Never empty.
        rankings
            By scorer; ``rankings["covis"]`` and ``rankings["b-aware"]`` are there, any other scorer's ranking is made
            when it is asked for (`nbv.scorers.registry.Rankings`).
        """


def budget_fraction(state: PlanningState) -> float:
    """f_b of Eq. 9: adaptive captures used over the adaptive budget; the seeds count in neither."""
    return state.captures_used / max(1, state.adaptive_budget)
