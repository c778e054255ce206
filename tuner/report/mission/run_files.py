"""What the figures read of a mission's run directory."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from nbv import safe_files
from nbv.config import MissionConfig, config_from_dict
from nbv.errors import UserError
from nbv.mission.run_directory import LOCATED
from nbv.types import Floats


def mission_config(run: Path) -> MissionConfig:
    """The configuration of a mission's directory; ``UserError`` if it is not there."""
    file = run / "config.yaml"
    if not file.is_file():
        raise UserError(f"{run} holds no config.yaml; name a directory that `gatetune mission run` wrote")
    return config_from_dict(safe_files.read_yaml(file))


def planned_config(run: Path) -> MissionConfig:
    """The configuration that the mission planned with: with the target where the mission found it."""
    located = run / LOCATED
    return config_from_dict(safe_files.read_yaml(located)) if located.is_file() else mission_config(run)


def read_json(run: Path, name: str) -> dict[str, Any]:
    """A JSON file of a mission's directory; ``UserError`` if it is not there."""
    file = run / name
    if not file.is_file():
        raise UserError(
            f"{run} holds no {name}; fly the mission with everything kept (`gatetune mission run`, or --keep all)"
        )
    tree = safe_files.read_json(file, safe_files.RESULT_BYTES, safe_files.RESULT_NODES)
    if not isinstance(tree, dict):
        raise UserError(f"{file} is not an object; restore it")
    return tree


def read_flight(run: Path) -> dict[str, Any]:
    """What a mission flew: its events and samples; ``UserError`` if the mission kept nothing of it."""
    flight = read_json(run, "flight.json")
    try:
        samples = np.array([row[:4] for row in flight["samples"]], dtype=float)
        sound = samples.ndim == 2 and samples.shape[1] == 4 and math.isfinite(flight["flight_time_s"])
        for event in flight["events"]:
            sound &= isinstance(event["name"], str) and math.isfinite(event["start_s"] + event["duration_s"])
    except (KeyError, TypeError, ValueError, IndexError):
        sound = False
    if not sound:
        raise UserError(f"{run / 'flight.json'} is not a mission's flight; restore it")
    return flight


def arrivals(flight: Mapping[str, Any]) -> dict[str, Floats]:
    """(3,) by viewpoint's name: where the vehicle was when it photographed there, in the order flown."""
    samples = np.array([sample[:4] for sample in flight["samples"]])
    found = {}
    for event in flight["events"]:
        if event["name"].startswith(("seed_", "cand_")):
            row = np.searchsorted(samples[:, 0], event["start_s"] + event["duration_s"])
            found[event["name"]] = samples[min(row, len(samples) - 1), 1:]
    return found


def thin_indices(total: int, count: int) -> np.ndarray:
    """At most ``count`` indices of ``range(total)``: a fixed random choice, in order."""
    if total <= count:
        return np.arange(total)
    return np.sort(np.random.default_rng(0).permutation(total)[:count])
