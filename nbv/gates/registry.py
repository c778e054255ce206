"""Which gate a configuration names, and the gate of a scorer's name."""

from __future__ import annotations

from nbv.config import GATES, SCORERS, MissionConfig
from nbv.errors import UserError
from nbv.gates.base import Gate
from nbv.gates.controls import HeuristicGate, MovementGate, RandomGate
from nbv.gates.ground_truth import GroundTruthOracle
from nbv.gates.oracle import GreedyOracleGate, OracleGate
from nbv.types import CandidatePool, GateDecision, PlanningState, Ranking

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
