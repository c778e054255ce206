"""Missions whose traces say, beside every decision, what an oracle would have gained: fidelities for research.

gatetune campaign run --fidelity research.with_oracle:photogrammetric ...
"""

from __future__ import annotations

import functools

from nbv.geometric import run_geometric_mission
from nbv.photogrammetric import run_photogrammetric_mission
from tuner.missions.registry import require_fidelity

photogrammetric = functools.partial(run_photogrammetric_mission, with_oracle=True)
geometric = functools.partial(run_geometric_mission, with_oracle=True)


def with_oracle(name: str) -> str:
    """The fidelity ``name``, or the one here that flies the same missions; `UserError` if there is no such name."""
    require_fidelity(name)
    return f"{__name__}:{name}" if name in ("photogrammetric", "geometric") else name
