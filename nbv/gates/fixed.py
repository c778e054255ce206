"""One scorer flown alone."""

from __future__ import annotations

from dataclasses import dataclass

from nbv.gates.base import Gate, GateInputs
from nbv.types import CandidatePool, GateDecision, PlanningState, Ranking


@dataclass(frozen=True)
class FixedGate(Gate):
    """Always the same scorer. It has no kind of its own: every scorer's name is one."""

    scorer: str

    @classmethod
    def make(cls, given: GateInputs) -> FixedGate:
        """Of the scorer that the kind names."""
        return cls(given.config.gate.kind)

    def decide(self, state: PlanningState, pool: CandidatePool, rankings: dict[str, Ranking]) -> GateDecision:
        """The fixed scorer's ranking."""
        return GateDecision(rankings[self.scorer], f"always {self.scorer}")
