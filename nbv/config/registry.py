"""What a configuration may name, and where it lives: built-in parts stand here, those of other packages in `nbv.plugins`.

Only names and references: no part is imported before it is asked for. So a name is checked when a configuration is
read, long before a mission runs, and what needs OpenGL or CUDA loads only where it is used.
"""

from __future__ import annotations

import pkgutil
from collections.abc import Iterator, Mapping
from typing import Any

from nbv import plugins
from nbv.errors import UserError


class Registry(Mapping[str, str]):
    """Names, and the ``module:attribute`` that each stands for: those built in, ``own``, then the plug-ins of a group."""

    def __init__(self, group: str, own: dict[str, str]) -> None:
        self.group, self.own = group, own

    def brought(self) -> dict[str, plugins.Plugin]:
        """The plug-ins by name, as `plugins.beside` the built-in parts."""
        both_are_kinds = self.group in ("scorers", "gates")
        taken = SCORERS.own | GATES.own if both_are_kinds else self.own
        return plugins.beside(taken.keys(), self.group)

    def plugin(self, name: str) -> plugins.Plugin | None:
        """The plug-in of that name; None where it is built in or nothing has it."""
        return self.brought().get(name)

    def __getitem__(self, name: str) -> str:
        found = self.plugin(name)
        return found.reference if found else self.own[name]

    def __iter__(self) -> Iterator[str]:
        return iter({**self.own, **self.brought()})

    def __len__(self) -> int:
        return sum(1 for _ in self)

    def require(self, name: str) -> None:
        """`UserError` where there is no part of that name."""
        if name not in self:
            known = ", ".join(self)
            raise UserError(
                f"unknown {plugins.GROUPS[self.group][0]} {name!r}; there are {known}, or a plug-in's (gatetune --plugin)"
            )

    def load(self, name: str) -> Any:
        """Import and return the object registered as ``name``.

        Raises `UserError`: the name is unknown, or a plug-in's object is not of the kind that its group asks for.
        """
        found = self.plugin(name)
        if found is not None:
            return found.loaded
        self.require(name)
        return pkgutil.resolve_name(self.own[name])


# A `nbv.scorers.scorer.Scorer` each. The gate of the same name always takes its ranking.
SCORERS = Registry(
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
    "renderers",
    {
        "raycast": "nbv.scene.raycast:RaycastRenderer",
        "gl": "nbv.scene.gl:GLRenderer",
    },
)

# A `nbv.dense.DenseBackend` each.
DENSE_BACKENDS = Registry(
    "dense",
    {
        "sgbm": "nbv.dense.stereo:sgbm_depth_maps",
        "patchmatch": "nbv.dense.patchmatch:patchmatch_depth_maps",
    },
)


def gate_kinds() -> tuple[str, ...]:
    """The values of ``gate.kind``: every scorer alone, then the gates."""
    return (*SCORERS, *GATES)
