"""Gates: which scorer's ranking is used. `make_gate` builds the one that a configuration names.

Two of them see the ground truth and are upper references, not planners: they say so (`Gate.sees_ground_truth`).
"""

from nbv.gates.base import Gate
from nbv.gates.ground_truth import GroundTruthOracle
from nbv.gates.registry import gate_class, make_gate

__all__ = [
    "Gate",
    "GroundTruthOracle",
    "gate_class",
    "make_gate",
]
