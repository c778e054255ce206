"""Conditions: named environments of a mission; each is a YAML file that replaces fields of the sections that describe one.

``conditions/NAME.yaml`` holds sections and their fields, and may say ``description: ...``::

    description: bright day, no wind
    scene: {ambient: 0.2}
    telemetry: gnss        # a level, or fields
"""

from __future__ import annotations

import dataclasses
import json
import re
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from nbv.config.declaration import nearest
from nbv.config.mission_config import IDEAL, MissionConfig, config_from_dict
from nbv.config.sections_world import telemetry_level
from nbv.errors import UserError
from nbv.safe_files import read_yaml

_NAMES = {f.name for f in dataclasses.fields(MissionConfig)}
ENVIRONMENT_SECTIONS = ("scene", "sensor", "wind", "telemetry", "target")


@dataclass(frozen=True)
class Condition:
    """A named environment: light, sensor, wind, telemetry and knowledge of the target."""

    name: str
    values: dict[str, dict[str, Any]] = field(default_factory=dict)  # fields by section
    description: str = ""

    @property
    def paths(self) -> tuple[str, ...]:
        """Parameter paths that it sets."""
        return tuple(f"{section}.{name}" for section, fields in self.values.items() for name in fields)

    def to_dict(self) -> dict[str, Any]:
        """As its YAML file has it; ``condition_from_dict`` reads it back."""
        return {**({"description": self.description} if self.description else {}), **self.values}


IDEAL_CONDITION = Condition(IDEAL)


def under(config: MissionConfig, condition: Condition) -> MissionConfig:
    """``config`` under the condition; the same object under ``ideal``.

    `UserError` where ``config`` is under another condition already.
    """
    if config.condition not in (IDEAL, condition.name):
        raise UserError(
            f"the configuration is under condition {config.condition!r} already, not under {condition.name!r}; "
            "begin with one that is under none"
        )
    if condition.name == IDEAL:
        return config
    return config_from_dict({"condition": condition.name, **condition.values}, config)


def shipped_files(folder: str) -> dict[str, Path]:
    """The YAML files in ``conditions`` or ``search_spaces`` by name: those of a clone, then the installed data files."""
    beside = Path(__file__).resolve().parents[2] / folder
    installed = Path(sys.prefix) / "share" / "gatetune" / folder
    return {file.stem: file for where in (installed, beside) for file in sorted(where.glob("*.yaml"))}


def load_conditions(names_or_paths: Sequence[str]) -> tuple[Condition, ...]:
    """As `load_condition`, in order; ``UserError`` where two have one name."""
    conditions = tuple(load_condition(name) for name in names_or_paths)
    require_distinct(conditions)
    return conditions


def require_distinct(conditions: Sequence[Condition]) -> None:
    """``UserError`` where there is none, or two have one name."""
    names = [condition.name for condition in conditions]
    if not names:
        raise UserError(f"there is no condition to run under; name at least one, such as {IDEAL}")
    for name in names:
        if names.count(name) > 1:
            raise UserError(f"condition {name!r} is named twice; name each condition once")


def load_condition(name_or_path: str) -> Condition:
    """The condition of that name, or in that YAML file.

    `UserError` where there is no such condition, or for a mistake in the file.
    """
    named = dict(sorted(shipped_files("conditions").items(), key=lambda item: item[0] != IDEAL))
    path = named.get(name_or_path, Path(name_or_path))
    if name_or_path not in named and path.suffix not in (".yaml", ".yml"):
        raise UserError(
            f"unknown condition {name_or_path!r}; there are {', '.join(named)}, or give a YAML file"
        )
    return condition_from_dict(path.stem, read_yaml(path), str(path))


def condition_from_dict(name: str, tree: Any, source: str) -> Condition:
    """Build and check a condition from its YAML tree; ``source`` names it in messages.

    `UserError` for a section that does not describe the environment, an unknown field, a value of the wrong type or out of range.
    """
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_.-]*", name):
        raise UserError(f"{source}: {name!r} cannot name a condition; use letters, digits and dashes")
    if not isinstance(tree := {} if tree is None else tree, dict):
        raise UserError(f"{source}: a condition maps sections to fields, such as `scene: {{ambient: 0.1}}`")
    description = tree.get("description", "")
    if not isinstance(description, str):
        raise UserError(f"{source}: description is {description!r}; it must be a text")
    values = {section: fields for section, fields in tree.items() if section != "description"}
    if name == IDEAL and values:
        raise UserError(
            f"{source}: {IDEAL} is the name of the default environment; give the file another name"
        )
    try:
        for section in values:
            if section in ENVIRONMENT_SECTIONS:
                continue
            if section in _NAMES:
                sections = ", ".join(ENVIRONMENT_SECTIONS)
                raise UserError(f"{section} is no part of the environment; a condition sets {sections}")
            near = nearest(str(section), ENVIRONMENT_SECTIONS)
            raise UserError(f"a condition has no section {str(section)!r}; {near}")
        if isinstance(level := values.get("telemetry"), str):
            values["telemetry"] = json.loads(json.dumps(dataclasses.asdict(telemetry_level(level))))
        condition = Condition(name, values, description)
        under(MissionConfig(), condition)
    except UserError as error:
        raise UserError(f"{source}: {error}") from error
    return condition
