"""Hyb-H, the paper's heuristic hybrid (Eq. 9)."""

from __future__ import annotations

from dataclasses import dataclass

from nbv.gates.base import Gate, GateInputs, budget_fraction
from nbv.scorers import B_AWARE, COVIS
from nbv.types import CandidatePool, GateDecision, PlanningState, Ranking


@dataclass(frozen=True)
class HeuristicGate(Gate):
    """The geometry scorer (B-aware) while little of the budget is used or the sparse cloud is coarse, else Covis.

    Both inequalities are strict, and there is no memory: a cloud that coarsens again switches back.
    An infinite ``d95_m`` (too few points to tell) counts as coarse.
    """

    budget_fraction: float
    d95_m: float
    geometry_scorer: str = B_AWARE.name

    @classmethod
    def make(cls, given: GateInputs) -> HeuristicGate:
        """With the configuration's thresholds."""
        gate = given.config.gate
        return cls(gate.budget_fraction, gate.d95_m, gate.geometry_scorer)

    def decide(self, state: PlanningState, pool: CandidatePool, rankings: dict[str, Ranking]) -> GateDecision:
        """Eq. 9."""
        f_b = budget_fraction(state)
        early, coarse = f_b < self.budget_fraction, state.d95_m > self.d95_m
        details = {"f_b": f_b, "d95_m": state.d95_m, "early": early, "coarse": coarse}
        if early or coarse:
            reason = " and ".join(
                text
                for holds, text in (
                    (early, f"f_b {f_b:.3f} < {self.budget_fraction:g}"),
                    (coarse, f"d95 {state.d95_m:.4f} m > {self.d95_m:g} m"),
                )
                if holds
            )
            return GateDecision(rankings[self.geometry_scorer], reason, details)
        reason = f"f_b {f_b:.3f} and d95 {state.d95_m:.4f} m ask for no repair"
        return GateDecision(rankings[COVIS.name], reason, details)
