"""The base scorers flown alone."""

from __future__ import annotations

from dataclasses import dataclass

from nbv.types import CandidatePool, GateDecision, PlanningState, Ranking


@dataclass(frozen=True)
class FixedGate:
    """Always the same scorer: ``"covis"`` or ``"b-aware"``."""

    scorer: str

    def decide(self, state: PlanningState, pool: CandidatePool, rankings: dict[str, Ranking]) -> GateDecision:
        """The fixed scorer's ranking."""
        return GateDecision(rankings[self.scorer], f"always {self.scorer}")
