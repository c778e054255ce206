"""Rocks that the mission server holds in memory, so that the missions it forks need not read them again.

Reading a rock takes 0.1 s from the store and 0.5 to 1.5 s from a mesh file, which is imported anew: more than a
geometric mission itself. The server loads a rock once a mission of its own has flown it, never before: a mesh that
ends the process that reads it ends a mission, not the server.
"""

from __future__ import annotations

import importlib
import sys
from typing import Any

from nbv.safe_files import expanded
from tuner.missions.registry import EXTERNAL, FIDELITIES, is_geometric, module_of

MAX_HELD_BYTES = 256 * 2**20  # eight to ten rocks of the catalogue
# Importing a larger mesh takes more memory than there may be beside the missions.
MAX_FILE_BYTES = 100 * 2**20


class SharedRocks:
    """The rocks of jobs that were flown, in this process's memory."""

    def __init__(self) -> None:
        self._known: set[str] = set()
        self.held_bytes = 0

    def keep(self, job: dict[str, Any]) -> None:
        """Load the rock of ``job``, whose mission has ended well; nothing if that cannot be done.

        Only for registered fidelities: what other fidelities call a rock is their own business.
        """
        rock, fidelity = job["rock"], job["fidelity"]
        if (
            fidelity == EXTERNAL
            or fidelity not in FIDELITIES
            or rock in self._known
            or self.held_bytes >= MAX_HELD_BYTES
        ):
            return
        self._known.add(rock)
        try:
            importlib.import_module(module_of(fidelity))
            path = expanded(rock)
            if path.is_file() and path.stat().st_size > MAX_FILE_BYTES:
                return
            from nbv.cache import Store  # noqa: PLC0415  the server stays light
            from nbv.rocks import load_coarse_rock, load_rock  # noqa: PLC0415

            mesh = (load_coarse_rock if is_geometric(fidelity) else load_rock)(rock, Store())
        except Exception as error:  # the next mission on it meets the same error and records it
            print(f"rock {rock!r} is not shared: {error}", file=sys.stderr)
            return
        self.held_bytes += mesh.vertices_m.nbytes + mesh.faces.nbytes + mesh.albedo.nbytes
