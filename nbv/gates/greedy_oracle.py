"""The greedy ceiling: the candidate that really gains most. GROUND TRUTH: not deployable."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from nbv.gates.base import Gate, GateInputs
from nbv.gates.controls import ranking_of
from nbv.gates.truth import Oracle
from nbv.types import CandidatePool, GateDecision, PlanningState, Ranking


@dataclass(frozen=True)
class GreedyOracleGate(Gate):
    """Ranks the whole pool by the oracle's gain; ties keep pool order. Reads the ground truth."""

    sees_ground_truth: ClassVar[bool] = True
    oracle: Oracle

    @classmethod
    def make(cls, given: GateInputs) -> GreedyOracleGate:
        """With the rock's truth."""
        return cls(given.truth)

    def decide(self, state: PlanningState, pool: CandidatePool, rankings: dict[str, Ranking]) -> GateDecision:
        """Falling gain."""
        coverage = self.oracle.coverage(state)
        gains = np.array([self.oracle.gain(p, coverage) for p in pool.positions_m])
        ranking = ranking_of("greedy-oracle", gains, rankings)
        rewards = {name: float(gains[r.top]) for name, r in rankings.items()}
        rewards["greedy-oracle"] = float(gains[ranking.top])
        details = {
            "ground_truth": True,
            "coverage": self.oracle.config.gate.oracle_coverage,
            "oracle_rewards": rewards,
            "covered_fraction": float(coverage.covered.mean()),
        }
        reason = f"ground truth: gains {gains[ranking.top]:g} of {len(coverage.covered)} samples"
        return GateDecision(ranking, reason, details)
