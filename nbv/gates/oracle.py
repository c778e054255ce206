"""Hyb-O: the paper's oracle hybrid. GROUND TRUTH: not deployable."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from nbv.gates.base import Gate, GateInputs
from nbv.gates.ground_truth import GroundTruthOracle, oracle_rewards
from nbv.scorers import B_AWARE, COVIS
from nbv.types import CandidatePool, GateDecision, PlanningState, Ranking


@dataclass(frozen=True)
class OracleGate(Gate):
    """Covis or the geometry scorer (B-aware), whichever's top candidate covers more uncovered ground-truth samples; ties go to Covis.

    It compares two candidates only and looks one step ahead, so it is not a ceiling (see
    `nbv.gates.greedy_oracle`). Reads the ground truth.
    """

    sees_ground_truth: ClassVar[bool] = True
    oracle: GroundTruthOracle
    geometry_scorer: str = B_AWARE.name

    @classmethod
    def make(cls, given: GateInputs) -> OracleGate:
        """With the rock's truth."""
        return cls(given.truth, given.config.gate.geometry_scorer)

    def decide(self, state: PlanningState, pool: CandidatePool, rankings: dict[str, Ranking]) -> GateDecision:
        """The geometry scorer if and only if its reward is strictly larger."""
        covis, geometry = COVIS.name, self.geometry_scorer
        both = {name: rankings[name] for name in (covis, geometry)}
        rewards = oracle_rewards(self.oracle, state, pool, both)
        chosen = geometry if rewards[geometry] > rewards[covis] else covis
        reason = (
            f"ground truth: {covis} would gain {rewards[covis]:g}, {geometry} {rewards[geometry]:g} samples"
        )
        details = {
            "ground_truth": True,
            "coverage": self.oracle.config.gate.oracle_coverage,
            "oracle_rewards": rewards,
            "tie": rewards[covis] == rewards[geometry],
        }
        return GateDecision(rankings[chosen], reason, details)
