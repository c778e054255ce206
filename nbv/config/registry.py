"""What a configuration may name, and where it lives: built-in parts stand here, those of other packages in `nbv.plugins`.

Only names and references: no part is imported before it is asked for. So a name is checked when a configuration is
read, long before a mission runs, and what needs OpenGL or CUDA loads only where it is used.
"""

from __future__ import annotations

import importlib
from collections.abc import Collection, Iterator, MutableMapping
from typing import Any

from nbv import plugins
from nbv.errors import UserError


class Registry(MutableMapping[str, str]):
    """Names, and the ``module:attribute`` that each stands for: those built in, ``own``, then those of plug-ins.

    ``what`` is named in messages: "gate"; ``group`` is the plug-ins' (`nbv.plugins.GROUPS`). ``registry[name] = reference`` adds one at
    run time.
    """

    def __init__(self, what: str, group: str, own: dict[str, str]) -> None:
        self.what, self.group, self.own = what, group, own

    def plugin(self, name: str) -> plugins.Plugin | None:
        """The plug-in of that name; None where it is built in or nothing has it.

        `UserError` where two plug-ins have one name, or one has a built-in name.
        """
        if name in self.own:
            return None
        return plugins.beside(self.own.keys(), self.group).get(name)

    def __getitem__(self, name: str) -> str:
        if name in self.own:
            return self.own[name]
        found = self.plugin(name)
        if found is None:
            raise KeyError(name)
        return found.reference

    def __setitem__(self, name: str, reference: str) -> None:
        self.own[name] = reference

    def __delitem__(self, name: str) -> None:
        del self.own[name]

    def __iter__(self) -> Iterator[str]:
        return iter({**self.own, **plugins.plugins(self.group)})

    def __len__(self) -> int:
        return sum(1 for _ in self)

    def load(self, name: str) -> Any:
        """What ``name`` stands for; ``UserError`` if nothing has that name, or a plug-in is no such thing."""
        found = self.plugin(name)
        if found is not None:
            return found.loaded
        if name not in self.own:
            raise UserError(f"unknown {self.what} {name!r}; there are {', '.join(self)}")
        module, _, attribute = self.own[name].partition(":")
        return getattr(importlib.import_module(module), attribute)


# A `nbv.scorers.scorer.Scorer` each. Flown alone by the gate of the same name.
SCORERS = Registry(
    "scorer",
    "scorers",
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
    "gates",
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
    "renderers",
    {
        "raycast": "nbv.scene.raycast:RaycastRenderer",
        "gl": "nbv.scene.gl:GLRenderer",
    },
)

# A `nbv.dense.DenseBackend` each.
DENSE_BACKENDS = Registry(
    "dense backend",
    "dense",
    {
        "sgbm": "nbv.dense.stereo:sgbm_depth_maps",
        "patchmatch": "nbv.dense.patchmatch:patchmatch_depth_maps",
    },
)


class _Kinds(Collection[str]):
    """Built-in kinds are found without a look at what is installed."""

    def __contains__(self, name: object) -> bool:
        return any(name in names for names in (SCORERS.own, GATES.own, SCORERS, GATES))

    def __iter__(self) -> Iterator[str]:
        return iter((*SCORERS, *GATES))

    def __len__(self) -> int:
        return len(SCORERS) + len(GATES)


def gate_kinds() -> Collection[str]:
    """The values of ``gate.kind``: every scorer alone, then the gates."""
    return _Kinds()
