"""What the figures read of a mission's run directory."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import yaml

from nbv.config import MissionConfig, config_from_dict
from nbv.errors import UserError


def mission_config(run: Path) -> MissionConfig:
    """The configuration of a mission's directory; ``UserError`` if it is not there."""
    file = run / "config.yaml"
    if not file.is_file():
        raise UserError(f"{run} holds no config.yaml; name a directory that `gatetune mission run` wrote")
    return config_from_dict(yaml.safe_load(file.read_text()))


def read_json(run: Path, name: str) -> dict[str, Any]:
    """A JSON file of a mission's directory; ``UserError`` if it is not there."""
    file = run / name
    if not file.is_file():
        raise UserError(
            f"{run} holds no {name}; fly the mission with everything kept (`gatetune mission run`, or --keep all)"
        )
    tree: dict[str, Any] = json.loads(file.read_text())
    return tree


def read_trace(run: Path) -> list[dict[str, Any]]:
    """The records of every adaptive iteration; ``UserError`` if the mission kept none."""
    file = run / "trace.jsonl"
    if not file.is_file():
        raise UserError(f"{run} holds no trace.jsonl; fly the mission with everything kept")
    return [json.loads(line) for line in file.read_text().splitlines() if line.strip()]
