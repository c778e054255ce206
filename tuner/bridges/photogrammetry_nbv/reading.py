"""From their values to ours."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from nbv.errors import UserError
from tuner.bridges.photogrammetry_nbv.keys import (
    BASELINE_AWARE,
    CRITERION_OF_OURS,
    HYBRID,
    LEAST_SCALE_M,
    MISSION,
    MODE_OF_GATE,
    REPAIR,
    SCALES,
    SCORER_OF_GATE,
    SCORING,
    Key,
    Remark,
)

Values = dict[str, Any]
UNITS_OF_KNN = "in COLMAP's units there, in metres here; the same number is another distance"
_OWN_BLOCK = ("target_track_length", "density_k")
_OWN_WEIGHTS = ("track_support", "local_density", "reprojection")


def read_scoring(theirs: Mapping[str, Any]) -> tuple[Values, list[Remark]]:
    """Our parameters, by path, that do what ``theirs`` (a ``scoring.yaml``, flat) does; and what is lost."""
    values, remarks = _direct(theirs, SCORING)
    # B-aware reads Repair's block while the file has one, and its own only otherwise.
    if not any(name.startswith(f"{REPAIR}.") for name in theirs):
        for name in (*_OWN_BLOCK, *(f"weakness_weights.{weight}" for weight in _OWN_WEIGHTS)):
            ours = next(key.ours for key in SCORING if key.path == f"{REPAIR}.{name}")
            own = next(key for key in SCORING if key.path == f"{BASELINE_AWARE}.{name}")
            values[str(ours)] = _number(theirs.get(own.path, own.default), own.path)
    for weight in ("nov", "move", "ang"):
        values[f"b_aware.weights.{weight}"] = values[f"covis.weights.{weight}"]
    main = [theirs.get(f"weights.{name}") for name in ("geometry_aware_repair", "repair", "covisibility")]
    given = next((value for value in main if value is not None), 1.0)
    values["b_aware.weights.main"] = _number(given, "weights.geometry_aware_repair")
    for path in SCALES:
        if values[path] < LEAST_SCALE_M:
            remarks.append(Remark(path, f"{values[path]:g} m counts as {LEAST_SCALE_M:g} m there"))
            values[path] = LEAST_SCALE_M
    values["gate.kind"], more = _gate(theirs)
    values["gate.geometry_scorer"] = "b-aware"
    values["visibility.mode"] = "frustum"
    remarks += more
    if "hybrid.heuristic.knn_p95_threshold" in theirs:
        remarks.append(Remark("gate.d95_m", UNITS_OF_KNN))
    return values, remarks


def _gate(theirs: Mapping[str, Any]) -> tuple[str, list[Remark]]:
    name, mode = theirs.get("name", HYBRID), theirs.get("hybrid.gate_mode", "heuristic")
    if name == HYBRID:
        for ours, there in MODE_OF_GATE.items():
            if mode == there:
                note = [Remark("gate.kind", "their oracle counts frusta only and always takes Covis")]
                return ours, note if ours == "hyb-o" else []
        # Every other mode flies the coverage scorer there, "shadow" with the others beside it.
        return "covis", [] if mode == "shadow" else [Remark("gate.kind", f"mode {mode!r} flies Covis there")]
    for ours, there in SCORER_OF_GATE.items():
        if name == there:
            return ours, []
    raise UserError(
        f"scorer name {name!r} has no counterpart here; there are {', '.join((*SCORER_OF_GATE.values(), HYBRID))}"
    )


def read_mission(theirs: Mapping[str, Any]) -> tuple[Values, list[Remark]]:
    """Our parameters, by path, that do what ``theirs`` (a ``unified_mission.yaml``, flat) does; and what is lost.

    Their frame is north, east, down from the take-off point; ours is east, north, up with the target above the origin.
    """
    defaults = {key.path: key.default for key in MISSION}
    given = {**defaults, **theirs}
    values, remarks = _direct(theirs, MISSION)
    for mode, here in (("seed_planner_mode", "stratified"), ("phase2_planner_mode", "hybrid")):
        if given[mode] != here:
            raise UserError(f"{mode} {given[mode]!r} has no counterpart here; only {here!r} has")
    north_m, east_m, down_m = (
        _number(given[f"rock_center_{axis}"], f"rock_center_{axis}") for axis in ("x", "y", "z")
    )
    values["target_m"] = (0.0, 0.0, -down_m)
    values["flight.home_m"] = (0.0 - east_m, 0.0 - north_m, 0.0)
    values["pool.max_altitude_m"] = -_number(given["min_altitude_ned"], "min_altitude_ned")
    values["pool.min_altitude_m"] = -_number(given["max_altitude_ned"], "max_altitude_ned")
    criterion = {there: ours for ours, there in CRITERION_OF_OURS.items()}
    if given["stopping_criterion"] not in criterion:
        raise UserError(
            f"stopping_criterion {given['stopping_criterion']!r} is unknown; there are {', '.join(criterion)}"
        )
    values["stop.criterion"] = criterion[given["stopping_criterion"]]
    if "knn_distance_threshold" in theirs:
        remarks.append(Remark("stop.knn_threshold_m", UNITS_OF_KNN))
    vertical = _number(given["position_tolerance_z"], "position_tolerance_z")
    if vertical != values["flight.arrival_tolerance_m"]:
        remarks.append(
            Remark("flight.arrival_tolerance_m", f"{vertical:g} m vertically there; here one for all axes")
        )
    counts = sum(values["seed.ring_azimuth_counts"])
    if given["ring_image_count"] != counts:
        remarks.append(Remark("ring_image_count", f"not used: seed_azimuth_counts make {counts}"))
    return values, remarks


def _direct(theirs: Mapping[str, Any], keys: Sequence[Key]) -> tuple[Values, list[Remark]]:
    """Keys with the same meaning and unit; and a remark for each that nothing here answers to and that was changed."""
    values: Values = {}
    remarks = []
    for key in keys:
        value = theirs.get(key.path, key.default)
        if key.ours is not None:
            values[key.ours] = _like(value, key)
        elif key.why_not and value != key.default:
            remarks.append(Remark(key.path, f"{value!r} has no counterpart: {key.why_not}"))
    missing = [key.path for key in keys if key.ours is not None and key.path not in theirs]
    if missing:
        remarks.append(Remark(", ".join(missing), "not in the file; taken as published"))
    return values, remarks


def _like(value: Any, key: Key) -> Any:
    """``value`` in the type of the key's default; a number may be whole."""
    if isinstance(key.default, list):
        if not isinstance(value, list) or not value:
            raise UserError(f"{key.path} is {value!r}; it must be a list of numbers")
        return tuple(_typed(item, key.default[0], key.path) for item in value)
    return _typed(value, key.default, key.path)


def _typed(value: Any, like: Any, path: str) -> Any:
    number = _number(value, path)
    if isinstance(like, int):
        if number != int(number):
            raise UserError(f"{path} is {value!r}; it must be a whole number")
        return int(number)
    return number


def _number(value: Any, path: str) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        raise UserError(f"{path} is {value!r}; it must be a number")
    return float(value)
