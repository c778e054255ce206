"""The names of parts that a configuration may hold: built in are those that stand here, others are plug-ins'.

What loads them lies above: `nbv.scorers.registry`, `nbv.gates.registry`, `nbv.scene.view` and `nbv.dense.reconstruct`.
"""

from __future__ import annotations

from nbv.plugins import Registry

_SCORERS = ("covis", "b-aware", "predicted")
_GATES = ("hyb-h", "hyb-o", "greedy-oracle", "random", "movement-only")

# A scorer's name is also that of the gate that always takes its ranking.
SCORERS = Registry("scorers", _SCORERS, reserved=_GATES)
GATES = Registry("gates", _GATES, reserved=_SCORERS)
RENDERERS = Registry("renderers", ("raycast", "gl"))
DENSE_BACKENDS = Registry("dense", ("sgbm", "patchmatch"))


def gate_kinds() -> tuple[str, ...]:
    """The values of ``gate.kind``: every scorer alone, then the gates."""
    return (*SCORERS, *GATES)
