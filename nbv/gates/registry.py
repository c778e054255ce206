"""Which gate a configuration names, and the gate of a scorer's name."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from nbv.config import GATES, SCORERS, MissionConfig
from nbv.errors import UserError
from nbv.gates.base import Gate, ranking_of
from nbv.gates.ground_truth import GroundTruthOracle
from nbv.process import keyed_rng
from nbv.scorers import COVIS
from nbv.types import CandidatePool, GateDecision, PlanningState, Ranking

# Hyb-H, the paper's heuristic hybrid (Eq. 9), and policies that use no main term: what any scorer has to beat.


class HeuristicGate(Gate):
    """The geometry scorer (B-aware) while little of the budget is used or the sparse cloud is coarse, else Covis.

    Both inequalities are strict, and there is no memory: a cloud that coarsens again switches back.
    An infinite ``d95_m`` (too few points to tell) counts as coarse.
    """

    def decide(self, state: PlanningState, pool: CandidatePool, rankings: dict[str, Ranking]) -> GateDecision:
        """Eq. 9; the seeds count neither as used nor in the budget."""
        gate, f_b = self.config.gate, state.captures_used / max(1, state.planned_views)
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


# Hyb-O, the paper's oracle hybrid, and the greedy ceiling. GROUND TRUTH: not deployable.


class OracleGate(Gate):
    """Covis or the geometry scorer (B-aware), whichever's top candidate covers more uncovered ground-truth samples; ties go to Covis.

    With ``gate.oracle_quality_weight`` (the first author's later code, f3120ba) a reward is the share of the uncovered
    samples plus that weight times the scorer's own main term, and ties go to the scorer that prefers its best by more.

    It compares two candidates only and looks one step ahead, so it is not a ceiling (see `GreedyOracleGate`).
    """

    sees_ground_truth: ClassVar[bool] = True

    def decide(self, state: PlanningState, pool: CandidatePool, rankings: dict[str, Ranking]) -> GateDecision:
        """The geometry scorer where its reward is larger; of a tie `gate.oracle_quality_weight` says more."""
        covis, geometry = COVIS.name, self.config.gate.geometry_scorer
        both = {name: rankings[name] for name in (covis, geometry)}
        coverage = self.truth.coverage(state)
        rewards = {name: self.truth.gain(pool.positions_m[r.top], coverage) for name, r in both.items()}
        worth, tied = rewards, covis
        if weight := self.config.gate.oracle_quality_weight:
            left = max(1, int(np.count_nonzero(~coverage.covered)))
            worth = {n: rewards[n] / left + weight * float(r.terms["main"][r.top]) for n, r in both.items()}
            tied = geometry if _margin(both[geometry]) > _margin(both[covis]) else covis
        tie = worth[geometry] == worth[covis]
        chosen = tied if tie else max(worth, key=worth.__getitem__)
        reason = (
            f"ground truth: {covis} would gain {rewards[covis]:g}, {geometry} {rewards[geometry]:g} samples"
        )
        return GateDecision(
            rankings[chosen], reason, {"ground_truth": True, "oracle_rewards": rewards, "tie": tie}
        )


class GreedyOracleGate(Gate):
    """The candidate that really gains most: the whole pool by the oracle's gain; ties keep pool order."""

    sees_ground_truth: ClassVar[bool] = True

    def decide(self, state: PlanningState, pool: CandidatePool, rankings: dict[str, Ranking]) -> GateDecision:
        """All candidates, ordered by the true surface that each would add; the best first."""
        coverage = self.truth.coverage(state)
        gains = np.array([self.truth.gain(p, coverage) for p in pool.positions_m])
        ranking = ranking_of("greedy-oracle", gains, rankings)
        rewards = {name: float(gains[r.top]) for name, r in rankings.items()}
        rewards["greedy-oracle"] = float(gains[ranking.top])
        reason = f"ground truth: gains {gains[ranking.top]:g} of {len(coverage.covered)} samples"
        return GateDecision(ranking, reason, {"ground_truth": True, "oracle_rewards": rewards})


def _margin(ranking: Ranking) -> float:
    """By how much the best candidate is better than the next."""
    best = ranking.scores[ranking.order[:2]]
    return float(best[0] - best[-1])


BUILT_IN: dict[str, type[Gate]] = {
    "hyb-h": HeuristicGate,
    "hyb-o": OracleGate,
    "greedy-oracle": GreedyOracleGate,
    "random": RandomGate,
    "movement-only": MovementGate,
}


class FixedGate(Gate):
    """One scorer alone, at every step. Its kind is the scorer's name."""

    def decide(self, state: PlanningState, pool: CandidatePool, rankings: dict[str, Ranking]) -> GateDecision:
        scorer = self.config.gate.kind
        return GateDecision(rankings[scorer], f"always {scorer}")


def gate_class(kind: str) -> type[Gate]:
    gate: type[Gate] = FixedGate if kind in SCORERS else GATES.load(kind, BUILT_IN)
    return gate


def make_gate(
    config: MissionConfig,
    rock_sha256: str = "",
    replicate: int = 0,
    oracle: GroundTruthOracle | None = None,
) -> Gate:
    """The gate that ``config.gate.kind`` names; only those that see the ground truth get it.

    `UserError` for an oracle gate without ground truth.
    """
    kind = config.gate.kind
    gate = gate_class(kind)
    if not gate.sees_ground_truth:
        oracle = None
    elif oracle is None:
        raise UserError(f"gate.kind {kind} needs the ground truth; give it an oracle, or choose another gate")
    if GATES.plugin(kind) is not None:
        rock_sha256 = ""
    return gate(config, rock_sha256, replicate, oracle)
