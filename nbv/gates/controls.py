"""Policies that use neither main term: what any scorer has to beat."""

from __future__ import annotations

from dataclasses import dataclass

from nbv.gates.base import Gate, GateInputs
from nbv.random_streams import keyed_rng
from nbv.scorers import COVIS
from nbv.scorers.scorer import falling
from nbv.types import CandidatePool, Floats, GateDecision, PlanningState, Ranking


def ranking_of(scorer: str, scores: Floats, rankings: dict[str, Ranking]) -> Ranking:
    """A ranking by ``scores`` (C,); ties keep pool order. Its main term is the score itself."""
    shared = rankings[COVIS.name].terms  # as in any ranking
    terms = {"main": scores, "nov": shared["nov"], "move": shared["move"], "ang": shared["ang"]}
    return Ranking(scorer, falling(scores), scores, terms)


@dataclass(frozen=True)
class RandomGate(Gate):
    """Any feasible candidate with equal probability, drawn per (rock, replicate, iteration)."""

    rock_sha256: str
    replicate: int

    @classmethod
    def make(cls, given: GateInputs) -> RandomGate:
        """With the mission's key."""
        return cls(given.rock_sha256, given.replicate)

    def decide(self, state: PlanningState, pool: CandidatePool, rankings: dict[str, Ranking]) -> GateDecision:
        """A random permutation of the pool."""
        rng = keyed_rng("random-gate", self.rock_sha256, self.replicate, state.iteration)
        return GateDecision(ranking_of("random", rng.random(len(pool)), rankings), "random view")


@dataclass(frozen=True)
class MovementGate(Gate):
    """The cheapest candidate to reach (Eq. 3 alone)."""

    def decide(self, state: PlanningState, pool: CandidatePool, rankings: dict[str, Ranking]) -> GateDecision:
        """Rising movement cost."""
        move = rankings[COVIS.name].terms["move"]
        return GateDecision(ranking_of("movement-only", -move, rankings), "smallest movement")
