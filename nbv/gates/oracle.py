"""Hyb-O: the paper's oracle hybrid. GROUND TRUTH: not deployable."""

from __future__ import annotations

from dataclasses import dataclass

from nbv.gates.ground_truth import GroundTruthOracle, oracle_rewards
from nbv.types import CandidatePool, GateDecision, PlanningState, Ranking


@dataclass(frozen=True)
class OracleGate:
    """The scorer whose top candidate covers more uncovered ground-truth samples; ties go to Covis.

    It compares two candidates only and looks one step ahead, so it is not a ceiling (see
    `nbv.gates.greedy_oracle`). Reads the ground truth.
    """

    oracle: GroundTruthOracle

    def decide(self, state: PlanningState, pool: CandidatePool, rankings: dict[str, Ranking]) -> GateDecision:
        """B-aware if and only if its reward is strictly larger."""
        both = {name: rankings[name] for name in ("covis", "b-aware")}
        rewards = oracle_rewards(self.oracle, state, pool, both)
        chosen = "b-aware" if rewards["b-aware"] > rewards["covis"] else "covis"
        reason = (
            f"ground truth: covis would gain {rewards['covis']:g}, b-aware {rewards['b-aware']:g} samples"
        )
        details = {
            "ground_truth": True,
            "coverage": self.oracle.config.gate.oracle_coverage,
            "oracle_rewards": rewards,
            "tie": rewards["covis"] == rewards["b-aware"],
        }
        return GateDecision(rankings[chosen], reason, details)
