"""Gates: which scorer's ranking is flown. `make_gate` builds the one that a configuration names.

Two of them see the ground truth and are upper references, not planners: they say so (`Gate.sees_ground_truth`).
What they need is loaded when it is asked for: a planner on a vehicle does without a ray caster.
"""

import importlib
from typing import TYPE_CHECKING, Any

from nbv.gates.base import Gate, GateInputs
from nbv.gates.features import gate_features
from nbv.gates.registry import gate_class, make_gate
from nbv.gates.truth import Oracle

if TYPE_CHECKING:
    from nbv.gates.ground_truth import GroundTruthOracle, make_oracle, oracle_rewards

__all__ = [
    "Gate",
    "GateInputs",
    "GroundTruthOracle",
    "Oracle",
    "gate_class",
    "gate_features",
    "make_gate",
    "make_oracle",
    "oracle_rewards",
]


def __getattr__(name: str) -> Any:
    if name not in ("GroundTruthOracle", "make_oracle", "oracle_rewards"):
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.ground_truth"), name)
