"""Hyb-O, the paper's oracle hybrid, and the greedy ceiling. GROUND TRUTH: not deployable."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from nbv.gates.base import Gate, ranking_of
from nbv.scorers import COVIS
from nbv.types import CandidatePool, GateDecision, PlanningState, Ranking


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
