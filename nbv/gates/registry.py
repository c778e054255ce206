"""From ``gate.kind`` to a gate; the kinds stand in `nbv.config.registry`."""

from __future__ import annotations

from nbv.config import GATES, SCORERS, MissionConfig
from nbv.errors import UserError
from nbv.gates.base import Gate, GateInputs
from nbv.gates.fixed import FixedGate
from nbv.gates.ground_truth import GroundTruthOracle, make_oracle
from nbv.rocks.rock import Rock


def gate_class(kind: str) -> type[Gate]:
    """The gates of one kind; ``UserError`` if there is no such kind."""
    found: type[Gate] = FixedGate if kind in SCORERS else GATES.load(kind)
    return found


def make_gate(
    config: MissionConfig,
    rock: Rock | None = None,
    replicate: int = 0,
    oracle: GroundTruthOracle | None = None,
) -> Gate:
    """The gate that ``config.gate.kind`` names.

    Parameters
    ----------
    rock, replicate
        Key of the random control's stream; the rock also is the ground truth. Only gates that see it get it.
    oracle
        An oracle that exists already (the same as ``make_oracle(config, rock)``), to share its work.

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
        if rock is None:
            raise UserError(
                f"gate.kind {kind} needs the ground truth; give it a rock, or choose another gate"
            )
        oracle = make_oracle(config, rock)
    sha256 = rock.sha256 if rock is not None else ""
    return gate.make(GateInputs(config, sha256, replicate, oracle))
