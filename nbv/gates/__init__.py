"""Gates: which scorer's ranking is flown. `make_gate` builds the one that a configuration names."""

from __future__ import annotations

from typing import TYPE_CHECKING

from nbv.config import MissionConfig
from nbv.errors import UserError
from nbv.gates.base import Gate
from nbv.gates.controls import MovementGate, NoveltyGate, RandomGate, UniformCoverageGate
from nbv.gates.features import gate_features
from nbv.gates.fixed import FixedGate
from nbv.gates.greedy_oracle import GreedyOracleGate
from nbv.gates.ground_truth import GroundTruthOracle, oracle_rewards
from nbv.gates.heuristic import HeuristicGate
from nbv.gates.learned import LearnedGate
from nbv.gates.oracle import OracleGate

if TYPE_CHECKING:
    from nbv.rocks.rock import Rock

__all__ = ["Gate", "GroundTruthOracle", "gate_features", "make_gate", "make_oracle", "oracle_rewards"]

ORACLE_KINDS = ("hyb-o", "greedy-oracle")


def make_oracle(config: MissionConfig, rock: Rock) -> GroundTruthOracle:
    """The ground truth of one rock, for oracle gates and for logging rewards off-policy."""
    return GroundTruthOracle(rock.vertices_m, rock.faces, config)


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
        Key of the random control's stream; the rock also is the oracle gates' ground truth. Only
        ``hyb-o`` and ``greedy-oracle`` look at it.
    oracle
        An oracle that exists already (the same as ``make_oracle(config, rock)``), to share its work.

    Raises
    ------
    UserError
        An oracle gate without ground truth, or a learned gate whose policy file cannot be read.
    """
    kind = config.gate.kind
    if kind in ORACLE_KINDS:
        if oracle is None and rock is None:
            raise UserError(
                f"gate.kind {kind} needs the ground truth; give it a rock, or choose another gate"
            )
        truth = oracle if oracle is not None else make_oracle(config, rock)  # type: ignore[arg-type]
        return OracleGate(truth) if kind == "hyb-o" else GreedyOracleGate(truth)
    if kind in ("covis", "b-aware"):
        return FixedGate(kind)
    if kind == "hyb-h":
        return HeuristicGate(config.gate.budget_fraction, config.gate.d95_m)
    if kind == "learned":
        return LearnedGate.from_file(config.gate.learned_policy, config)
    if kind == "random":
        return RandomGate(rock.sha256 if rock is not None else "", replicate)
    if kind == "novelty-only":
        return NoveltyGate()
    if kind == "movement-only":
        return MovementGate()
    return UniformCoverageGate(config.target_m)
