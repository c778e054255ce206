"""Missions whose traces say, beside every decision, what an oracle would have gained: fidelities for research.

gatetune campaign run --fidelity research.with_oracle:photogrammetric ...
"""

from __future__ import annotations

from pathlib import Path
from typing import Unpack

from nbv.config import MissionConfig
from nbv.geometric import run_geometric_mission
from nbv.mission import MissionOptions, MissionResult
from nbv.photogrammetric import run_photogrammetric_mission
from tuner.missions.registry import require_fidelity


def photogrammetric(
    config: MissionConfig,
    rock: str,
    replicate: int = 0,
    directory: Path | None = None,
    **options: Unpack[MissionOptions],
) -> MissionResult:
    """`run_photogrammetric_mission` with ``with_oracle=True``."""
    return run_photogrammetric_mission(config, rock, replicate, directory, **{**options, "with_oracle": True})


def geometric(
    config: MissionConfig,
    rock: str,
    replicate: int = 0,
    directory: Path | None = None,
    **options: Unpack[MissionOptions],
) -> MissionResult:
    """`run_geometric_mission` with ``with_oracle=True``."""
    return run_geometric_mission(config, rock, replicate, directory, **{**options, "with_oracle": True})


def with_oracle(name: str) -> str:
    """The fidelity ``name``, or the one here that flies the same missions; `UserError` if there is no such name."""
    require_fidelity(name)
    return f"{__name__}:{name}" if name in ("photogrammetric", "geometric") else name
