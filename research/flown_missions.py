"""Finished missions on disk."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from nbv.config import MissionConfig, config_from_dict
from nbv.errors import UserError
from nbv.mission.result import MissionResult
from nbv.safe_files import read_yaml


@dataclass(frozen=True)
class FlownMission:
    """A finished mission found on disk."""

    directory: Path
    config: MissionConfig
    result: MissionResult


def find_missions(directories: Sequence[Path]) -> list[FlownMission]:
    """All finished missions in or below the directories, in path order, each once.

    Raises
    ------
    UserError
        A directory without any, or a mission whose files cannot be read.
    """
    found: dict[Path, FlownMission] = {}
    for directory in directories:
        files = sorted(directory.rglob("mission.json")) if directory.is_dir() else []
        if not files:
            raise UserError(f"{directory} holds no finished mission (mission.json); name run directories")
        for file in files:
            if file.parent.resolve() in found:
                continue
            config = config_from_dict(read_yaml(file.parent / "config.yaml"))
            found[file.parent.resolve()] = FlownMission(file.parent, config, MissionResult.load(file))
    return list(found.values())
