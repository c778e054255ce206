"""What a gate is: it reads the state and returns one ranking to fly, unchanged (a hard switch)."""

from __future__ import annotations

from typing import Protocol

from nbv.types import CandidatePool, GateDecision, PlanningState, Ranking


class Gate(Protocol):
    """Chooses the ranking to fly.

    ``rankings`` holds both base scorers, ``"covis"`` and ``"b-aware"``, on ``pool``. A control or a
    planner of its own returns a ranking that is not among them, under its own name, so that the
    mission loop is the same for all. A gate that
    draws (`nbv.gates.controls.RandomGate`) draws from a stream keyed by rock, replicate and iteration.
    """

    def decide(self, state: PlanningState, pool: CandidatePool, rankings: dict[str, Ranking]) -> GateDecision:
        """The decision for one iteration; the pool is never empty."""
        ...


def budget_fraction(state: PlanningState) -> float:
    """f_b of Eq. 9: adaptive captures used over the adaptive budget; the seeds count in neither."""
    return state.captures_used / max(1, state.adaptive_budget)


def margin(ranking: Ranking) -> float:
    """Score of the best candidate minus that of the second; 0 for a pool of one."""
    if len(ranking.order) < 2:
        return 0.0
    return float(ranking.scores[ranking.order[0]] - ranking.scores[ranking.order[1]])
