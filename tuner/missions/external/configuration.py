"""The configuration of a mission that is not ours: its file, and a value for every parameter."""

from __future__ import annotations

import functools
import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from nbv.config import IDEAL, config_from_dict
from nbv.errors import UserError
from tuner.missions.external.mission_file import MissionFile, complete, load_mission_file
from tuner.problem.search_space import Configuration


@dataclass(frozen=True)
class ExternalConfig:
    """A `Configuration` of a mission file; `external_config` makes one."""

    file: Path  # absolute
    sha256: str  # of the file as it was when the campaign began
    values: Mapping[str, Any]  # of every parameter, by its name
    program: str = ""  # hash of what the mission ran then; another one is the campaign's to ask about

    condition: ClassVar[str] = IDEAL  # a mission file has instances for what differs

    @property
    def mission(self) -> MissionFile:
        """The mission file; ``UserError`` if it or its program is gone or another one by now."""
        return _known_mission_file(self.file, self.sha256, self.program)

    @property
    def preset(self) -> str:
        """The mission's name."""
        return self.mission.name

    def digest(self) -> str:
        """First 16 hex digits of the SHA-256 of file and values, wherever the file lies."""
        text = json.dumps([self.sha256, dict(self.values)], sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()[:16]

    def to_dict(self) -> dict[str, Any]:
        """The JSON form; `configuration_from_dict` reads it back."""
        return {
            "mission_file": str(self.file),
            "sha256": self.sha256,
            "program": self.program,
            "values": dict(self.values),
        }

    def with_values(self, values: dict[str, Any]) -> ExternalConfig:
        """A copy with the named parameters replaced; ``UserError`` for an unknown one or an inadmissible value."""
        return external_config(self.mission, {**self.values, **values})


def external_config(mission: MissionFile, values: Mapping[str, Any] | None = None) -> ExternalConfig:
    """The configuration at ``values``, at the defaults where they say nothing.

    Raises
    ------
    UserError
        A name that the mission file does not have, or a value that it does not allow.
    """
    complete_values = complete(mission.space, values or {}, str(mission.path))
    # 1 and 1.0 are the same number and would be two configurations.
    kinds = {"float": float, "int": int}
    plain = {
        p.path: kinds[p.kind](complete_values[p.path]) if p.kind in kinds else complete_values[p.path]
        for p in mission.space.parameters
    }
    return ExternalConfig(mission.path, mission.sha256, plain, mission.program)


def configuration_from_dict(tree: dict[str, Any]) -> Configuration:
    """The inverse of ``to_dict``, for our missions and for others."""
    if "mission_file" not in tree:
        return config_from_dict(tree)
    return ExternalConfig(Path(tree["mission_file"]), tree["sha256"], tree["values"], tree.get("program", ""))


def same_mission_file(file: Path, sha256: str) -> MissionFile:
    """The mission file, if it is still the one with that hash; ``UserError`` otherwise."""
    mission = load_mission_file(file)
    if mission.sha256 != sha256:
        raise UserError(
            f"{file} has changed since the campaign began; put it back as it was, or begin a new campaign"
        )
    return mission


@functools.lru_cache(maxsize=16)
def _known_mission_file(file: Path, sha256: str, program: str) -> MissionFile:
    mission = same_mission_file(file, sha256)
    if program not in ("", mission.program):
        raise UserError(
            f"the program of {file} changed while its missions flew; put it back, or resume and say so"
        )
    return mission
