"""What the authors' files do, in our parameters: an independent way back for tests of what is written to them."""

from collections.abc import Mapping, Sequence
from typing import Any

from tuner.export.photogrammetry_nbv import (
    BASELINE_AWARE,
    HYBRID,
    MISSION,
    MODE_OF_GATE,
    REPAIR,
    SCORER_OF_GATE,
    SCORING,
    Key,
)

B_AWARE = {
    "target_track_length": "b_aware.target_track_length",
    "density_k": "b_aware.density_neighbours",
    "weakness_weights.track_support": "b_aware.alpha_track",
    "weakness_weights.local_density": "b_aware.alpha_density",
    "weakness_weights.reprojection": "b_aware.alpha_reprojection",
}


def read_scoring(theirs: Mapping[str, Any]) -> dict[str, Any]:
    """Our parameters, by path, that do what a flat ``scoring.yaml`` does."""
    values = _direct(theirs, SCORING)
    # B-aware reads Repair's block while the file has one, and its own only otherwise.
    if not any(name.startswith(f"{REPAIR}.") for name in theirs):
        own = {key.path: key.default for key in SCORING} | dict(theirs)
        values |= {ours: own[f"{BASELINE_AWARE}.{name}"] for name, ours in B_AWARE.items()}
    for weight in ("nov", "move", "ang"):
        values[f"b_aware.weights.{weight}"] = values[f"covis.weights.{weight}"]
    main = [theirs.get(f"weights.{name}") for name in ("geometry_aware_repair", "repair", "covisibility")]
    values["b_aware.weights.main"] = next((value for value in main if value is not None), 1.0)
    kinds = {there: ours for ours, there in MODE_OF_GATE.items()}
    kind = kinds.get(theirs.get("hybrid.gate_mode", "heuristic"), "covis")
    if (name := theirs.get("name", HYBRID)) != HYBRID:
        kind = {there: ours for ours, there in SCORER_OF_GATE.items()}[name]
    return {**values, "gate.kind": kind, "gate.geometry_scorer": "b-aware"}


def read_mission(theirs: Mapping[str, Any]) -> dict[str, Any]:
    """Our parameters, by path, that do what a flat ``unified_mission.yaml`` does.

    Their frame is north, east, down from the take-off point; ours is east, north, up with the target above the origin.
    """
    given = {key.path: key.default for key in MISSION} | dict(theirs)
    north_m, east_m, down_m = (given[f"rock_center_{axis}"] for axis in "xyz")
    return {
        **_direct(theirs, MISSION),
        "target_m": (0.0, 0.0, -down_m),
        "flight.home_m": (0.0 - east_m, 0.0 - north_m, 0.0),
        "pool.max_altitude_m": -given["min_altitude_ned"],
        "pool.min_altitude_m": -given["max_altitude_ned"],
        "stop.criterion": "budget" if given["stopping_criterion"] == "image_budget" else "both",
    }


def _direct(theirs: Mapping[str, Any], keys: Sequence[Key]) -> dict[str, Any]:
    """Keys with the same meaning and unit."""
    found = {key.parameter: theirs.get(key.path, key.default) for key in keys if key.parameter is not None}
    return {path: tuple(value) if isinstance(value, list) else value for path, value in found.items()}
