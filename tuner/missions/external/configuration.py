"""The configuration of an own mission: its mission file, and a value for every parameter."""

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
from tuner.missions.external.mission_file import MissionFile, load_mission_file
from tuner.problem.search_space import Configuration


@dataclass(frozen=True)
class ExternalConfig:
    """A `Configuration` of a mission file; `external_config` makes one."""

    mission_file: str  # absolute path
    sha256: str  # of the file when the campaign began
    program: str  # its hash when the session began
    values: Mapping[str, Any]  # of every parameter, by its name

    condition: ClassVar[str] = IDEAL  # a mission file has instances for what differs

    @property
    def mission(self) -> MissionFile:
        """The mission file; ``UserError`` if it or its program is gone or has changed."""
        return _unchanged(self.mission_file, self.sha256, self.program)

    @property
    def preset(self) -> str:
        """The mission's name."""
        return self.mission.name

    def digest(self) -> str:
        """Return the first 16 hex digits of the SHA-256 of file and values, wherever the file lies."""
        text = json.dumps([self.sha256, dict(self.values)], sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()[:16]

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON form; `configuration_from_dict` reads it back."""
        return {**vars(self), "values": dict(self.values)}

    def with_values(self, values: dict[str, Any]) -> ExternalConfig:
        """Return a copy with the named parameters replaced; ``UserError`` as `external_config`."""
        return external_config(self.mission, {**self.values, **values})


def external_config(mission: MissionFile, values: Mapping[str, Any]) -> ExternalConfig:
    """Return the configuration at ``values``, with defaults where they say nothing; ``UserError`` as `MissionFile.complete`."""
    return ExternalConfig(str(mission.path), mission.sha256, mission.program, mission.complete(values))


def configuration_from_dict(tree: dict[str, Any]) -> Configuration:
    """Return the inverse of ``to_dict``, for our missions and for others."""
    return ExternalConfig(**tree) if "mission_file" in tree else config_from_dict(tree)


@functools.lru_cache(maxsize=16)
def _unchanged(file: str, sha256: str, program: str) -> MissionFile:
    mission = load_mission_file(Path(file), sha256)
    if program != mission.program:
        raise UserError(
            f"the program of {file} changed while its missions flew; put it back, or resume and say so"
        )
    return mission
