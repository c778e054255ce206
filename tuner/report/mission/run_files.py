"""What the figures read of a mission's run directory."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

import nbv.foreign as foreign
from nbv.config import MissionConfig, config_from_dict
from nbv.errors import UserError
from nbv.types import Floats


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
    """The records of every adaptive iteration, none where no view was planned; ``UserError`` if nothing was kept."""
    file = run / "trace.jsonl"
    if not file.is_file():
        if (run / "flight.json").is_file():
            return []
        raise UserError(f"{run} holds no trace.jsonl; fly the mission with everything kept")
    lines = foreign.read_text(file, foreign.RESULT_BYTES).splitlines()
    return [foreign.parse_json(line, str(file)) for line in lines if line.strip()]


def arrivals(flight: Mapping[str, Any]) -> dict[str, Floats]:
    """(3,) by viewpoint's name: where the vehicle was when it photographed there, in the order flown."""
    samples = np.array([sample[:4] for sample in flight["samples"]])
    found = {}
    for event in flight["events"]:
        if event["name"].startswith(("seed_", "cand_")):
            row = np.searchsorted(samples[:, 0], event["start_s"] + event["duration_s"])
            found[event["name"]] = samples[min(row, len(samples) - 1), 1:]
    return found
