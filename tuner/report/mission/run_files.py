"""What the figures read of a mission's run directory."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import nbv.foreign as foreign
from nbv.config import MissionConfig, config_from_dict
from nbv.errors import UserError


def mission_config(run: Path) -> MissionConfig:
    """The configuration of a mission's directory; ``UserError`` if it is not there."""
    file = run / "config.yaml"
    if not file.is_file():
        raise UserError(f"{run} holds no config.yaml; name a directory that `gatetune mission run` wrote")
    return config_from_dict(foreign.read_yaml(file))


def read_json(run: Path, name: str) -> dict[str, Any]:
    """A JSON file of a mission's directory; ``UserError`` if it is not there."""
    file = run / name
    if not file.is_file():
        raise UserError(
            f"{run} holds no {name}; fly the mission with everything kept (`gatetune mission run`, or --keep all)"
        )
    tree = foreign.read_json(file, foreign.RESULT_BYTES, foreign.RESULT_NODES)
    if not isinstance(tree, dict):
        raise UserError(f"{file} is not an object; restore it")
    return tree


def read_trace(run: Path) -> list[dict[str, Any]]:
    """The records of every adaptive iteration; ``UserError`` if the mission kept none."""
    file = run / "trace.jsonl"
    if not file.is_file():
        raise UserError(f"{run} holds no trace.jsonl; fly the mission with everything kept")
    lines = foreign.read_text(file, foreign.RESULT_BYTES).splitlines()
    return [foreign.parse_json(line, str(file)) for line in lines if line.strip()]
