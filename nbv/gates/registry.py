"""From ``gate.kind`` to a gate; the kinds stand in `nbv.config.registry`."""

from __future__ import annotations

from dataclasses import dataclass

from nbv.config import GATES, SCORERS, MissionConfig
from nbv.errors import UserError
from nbv.gates.base import Gate, GateInputs
from nbv.gates.truth import Oracle
from nbv.types import CandidatePool, GateDecision, PlanningState, Ranking


@dataclass(frozen=True)
class FixedGate(Gate):
    """One scorer flown alone. It has no kind of its own: every scorer's name is one."""

    scorer: str

    @classmethod
    def make(cls, given: GateInputs) -> FixedGate:
        """Of the scorer that the kind names."""
        return cls(given.config.gate.kind)

    def decide(self, state: PlanningState, pool: CandidatePool, rankings: dict[str, Ranking]) -> GateDecision:
        """The fixed scorer's ranking."""
        return GateDecision(rankings[self.scorer], f"always {self.scorer}")


def gate_class(kind: str) -> type[Gate]:
    """The gates of one kind; ``UserError`` if there is no such kind."""
    found: type[Gate] = FixedGate if kind in SCORERS else GATES.load(kind)
    return found


def make_gate(
    config: MissionConfig,
    rock_sha256: str = "",
    replicate: int = 0,
    oracle: Oracle | None = None,
) -> Gate:
    """The gate that ``config.gate.kind`` names.

    Parameters
    ----------
    config
        Its ``gate``.
    rock_sha256, replicate
        Key of the random control's stream.
    oracle
        The ground truth. Only gates that see it get it.

    Raises
    ------
    UserError
        An oracle gate without ground truth, or a learned gate whose policy file cannot be read.
    """
    kind = config.gate.kind
    gate = gate_class(kind)
    if not gate.sees_ground_truth:
        oracle = None
    elif oracle is None:
        raise UserError(f"gate.kind {kind} needs the ground truth; give it an oracle, or choose another gate")
    return gate.make(GateInputs(config, rock_sha256, replicate, oracle))
