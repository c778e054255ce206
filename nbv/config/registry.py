"""What a configuration may name, and where it lives: a new scorer or gate is one new file and one line here.

Only names and places: nothing is imported before it is asked for. So a name is checked when a configuration is
read, long before anything flies, and what needs OpenGL or CUDA loads only where it is used.
"""

from __future__ import annotations

import importlib
from collections.abc import Collection
from typing import Any

from nbv.errors import UserError


class Registry(dict[str, str]):
    """Names, and the ``module:attribute`` that each stands for.

    Parameters
    ----------
    what
        What is named, for messages: "gate".
    places
        ``module:attribute`` by name. ``registry[name] = place`` adds one at run time.
    """

    def __init__(self, what: str, places: dict[str, str]) -> None:
        super().__init__(places)
        self.what = what

    def load(self, name: str) -> Any:
        """What ``name`` stands for; ``UserError`` if nothing has that name."""
        if name not in self:
            raise UserError(f"unknown {self.what} {name!r}; there are {', '.join(self)}")
        module, _, attribute = self[name].partition(":")
        return getattr(importlib.import_module(module), attribute)


# A `nbv.scorers.scorer.Scorer` each. Flown alone by the gate of the same name.
SCORERS = Registry(
    "scorer",
    {
        "covis": "nbv.scorers.covis:COVIS",
        "b-aware": "nbv.scorers.b_aware:B_AWARE",
        "matchable": "nbv.scorers.matchable:MATCHABLE",
        "predicted": "nbv.scorers.prediction:PREDICTED",
    },
)

# A subclass of `nbv.gates.base.Gate` each.
GATES = Registry(
    "gate",
    {
        "hyb-h": "nbv.gates.controls:HeuristicGate",
        "hyb-o": "nbv.gates.oracle:OracleGate",
        "greedy-oracle": "nbv.gates.oracle:GreedyOracleGate",
        "learned": "nbv.gates.learned:LearnedGate",
        "random": "nbv.gates.controls:RandomGate",
        "movement-only": "nbv.gates.controls:MovementGate",
    },
)

# A class each that takes a `nbv.scene.Scene` and has the face of `nbv.scene.Renderer`.
RENDERERS = Registry(
    "renderer",
    {
        "raycast": "nbv.scene.raycast:RaycastRenderer",
        "gl": "nbv.scene.gl:GLRenderer",
    },
)

# A `nbv.dense.DenseBackend` each.
DENSE_BACKENDS = Registry(
    "dense backend",
    {
        "sgbm": "nbv.dense.stereo:sgbm_depth_maps",
        "patchmatch": "nbv.dense.patchmatch:patchmatch_depth_maps",
    },
)


def gate_kinds() -> Collection[str]:
    """The values of ``gate.kind``: every scorer alone, then the gates."""
    return (*SCORERS, *GATES)
