"""Hyb-H, the paper's heuristic hybrid (Eq. 9), and policies that use no main term: what any scorer has to beat."""

from __future__ import annotations

from nbv.gates.base import Gate, ranking_of
from nbv.random_streams import keyed_rng
from nbv.scorers import COVIS
from nbv.types import CandidatePool, GateDecision, PlanningState, Ranking


class HeuristicGate(Gate):
    """The geometry scorer (B-aware) while little of the budget is used or the sparse cloud is coarse, else Covis.

    Both inequalities are strict, and there is no memory: a cloud that coarsens again switches back.
    An infinite ``d95_m`` (too few points to tell) counts as coarse.
    """

    def decide(self, state: PlanningState, pool: CandidatePool, rankings: dict[str, Ranking]) -> GateDecision:
        """Eq. 9; the seeds count neither as used nor in the budget."""
        gate, f_b = self.config.gate, state.captures_used / max(1, state.adaptive_budget)
        early, coarse = f_b < gate.budget_fraction, state.d95_m > gate.d95_m
        details = {"f_b": f_b, "d95_m": state.d95_m, "early": early, "coarse": coarse}
        if early or coarse:
            reasons = [f"f_b {f_b:.3f} < {gate.budget_fraction:g}"] if early else []
            reasons += [f"d95 {state.d95_m:.4f} m > {gate.d95_m:g} m"] if coarse else []
            return GateDecision(rankings[gate.geometry_scorer], " and ".join(reasons), details)
        reason = f"f_b {f_b:.3f} and d95 {state.d95_m:.4f} m ask for no repair"
        return GateDecision(rankings[COVIS.name], reason, details)


class RandomGate(Gate):
    """Any feasible candidate with equal probability, drawn per (rock, replicate, iteration)."""

    def decide(self, state: PlanningState, pool: CandidatePool, rankings: dict[str, Ranking]) -> GateDecision:
        rng = keyed_rng("random-gate", self.rock_sha256, self.replicate, state.iteration)
        return GateDecision(ranking_of("random", rng.random(len(pool)), rankings), "random view")


class MovementGate(Gate):
    """The cheapest candidate to reach (Eq. 3 alone)."""

    def decide(self, state: PlanningState, pool: CandidatePool, rankings: dict[str, Ranking]) -> GateDecision:
        move = rankings[COVIS.name].terms["move"]
        return GateDecision(ranking_of("movement-only", -move, rankings), "smallest movement")
