"""Policies that use neither main term: what any scorer has to beat."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from nbv.config import MissionConfig
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
class NoveltyGate(Gate):
    """The candidate farthest from everything visited, saturating at ``d_scale`` (Eq. 2 alone)."""

    def decide(self, state: PlanningState, pool: CandidatePool, rankings: dict[str, Ranking]) -> GateDecision:
        """Falling novelty."""
        nov = rankings[COVIS.name].terms["nov"]
        return GateDecision(ranking_of("novelty-only", nov, rankings), "largest novelty")


@dataclass(frozen=True)
class MovementGate(Gate):
    """The cheapest candidate to reach (Eq. 3 alone)."""

    def decide(self, state: PlanningState, pool: CandidatePool, rankings: dict[str, Ranking]) -> GateDecision:
        """Rising movement cost."""
        move = rankings[COVIS.name].terms["move"]
        return GateDecision(ranking_of("movement-only", -move, rankings), "smallest movement")


@dataclass(frozen=True)
class UniformCoverageGate(Gate):
    """Farthest-point sampling of viewing directions, seeds included: the evenest coverage of the sphere.

    Unlike novelty it compares directions, so the seeds' larger radius does not count as new.
    """

    target_m: tuple[float, float, float]

    @classmethod
    def make(cls, given: GateInputs) -> UniformCoverageGate:
        """Around the mission's target."""
        return cls(given.config.target_m)

    def retargeted(self, config: MissionConfig) -> UniformCoverageGate:
        """Around the target that was found."""
        return replace(self, target_m=config.target_m)

    def decide(self, state: PlanningState, pool: CandidatePool, rankings: dict[str, Ranking]) -> GateDecision:
        """Falling angle to the nearest visited direction."""

        def directions(positions: Floats) -> Floats:
            delta = positions - np.array(self.target_m)
            return delta / np.linalg.norm(delta, axis=1, keepdims=True)

        if len(state.visited_m) == 0:
            angle = np.full(len(pool), np.pi)
        else:
            cosines = directions(pool.positions_m) @ directions(state.visited_m).T
            angle = np.arccos(np.clip(cosines.max(axis=1), -1.0, 1.0))
        ranking = ranking_of("uniform-coverage", angle, rankings)
        reason = f"farthest direction, {np.rad2deg(angle[ranking.top]):.1f} deg from any visited"
        return GateDecision(ranking, reason)
