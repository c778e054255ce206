"""The configuration of one of their missions: their files beside the mission file, and what is tuned on top."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from nbv.config import MissionConfig
from tuner.bridges.photogrammetry_nbv.files import read_file
from tuner.bridges.photogrammetry_nbv.reading import read_mission, read_scoring

FUNCTION = "tuner.bridges.photogrammetry_nbv.flying:fly"  # as the mission file names it
SHARED_WEIGHTS = ("nov", "move", "ang")


def configuration(values: Mapping[str, Any], fixed: Mapping[str, Any], folder: Path) -> MissionConfig:
    """Ours: what their files beside the mission file say, then ``fixed``, then ``values``.

    Weights that both scorers share there are B-aware's, too, unless they are given.
    """
    theirs = files_beside(folder)
    ours = read_scoring(theirs["scoring.yaml"])[0] | read_mission(theirs["unified_mission.yaml"])[0]
    given = {**fixed, **values}
    for name in SHARED_WEIGHTS:
        if f"covis.weights.{name}" in given:
            given.setdefault(f"b_aware.weights.{name}", given[f"covis.weights.{name}"])
    return MissionConfig().with_values({**ours, **given})


def files_beside(folder: Path) -> dict[str, dict[str, Any]]:
    """Their two files beside the mission file, flat, by kind; empty where one is missing."""
    kinds = ("scoring.yaml", "unified_mission.yaml")
    return {kind: read_file(folder / kind, kind) if (folder / kind).is_file() else {} for kind in kinds}
