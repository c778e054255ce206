"""From our configuration to their values, and what cannot be said there."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from nbv.config import MissionConfig
from nbv.errors import UserError
from tuner.bridges.photogrammetry_nbv.keys import (
    BASELINE_AWARE,
    CRITERION_OF_OURS,
    FILES,
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
_SHARED = ("nov", "move", "ang")


class NoSuchGate(UserError):
    """The authors' planner has no such gate or scorer."""


def write_scoring(
    config: MissionConfig, theirs: Mapping[str, Any] | None = None
) -> tuple[Values, list[Remark]]:
    """Return a ``scoring.yaml`` (flat) that does what ``config`` does; keys that we do not have are as in ``theirs``.

    Raises
    ------
    NoSuchGate
        The gate, or a scorer, does not exist there.
    """
    config = _with_the_flying_scorers_weights(config)
    values, remarks = _direct(config, SCORING, theirs), list[Remark]()
    values["name"], mode = _scorer(config)
    if mode is not None:
        values["hybrid.gate_mode"] = mode
    values["weights.geometry_aware_repair"], more = _geometry_weight(config)
    remarks += more
    values.pop("weights.repair", None)
    for name in ("target_track_length", "density_k"):
        values[f"{BASELINE_AWARE}.{name}"] = values[f"{REPAIR}.{name}"]
    for name in ("track_support", "local_density", "reprojection"):
        values[f"{BASELINE_AWARE}.weakness_weights.{name}"] = values[f"{REPAIR}.weakness_weights.{name}"]
    for path, key in SCALES.items():
        if (scale_m := _get(config, path)) < LEAST_SCALE_M:
            values[key] = LEAST_SCALE_M
            text = f"{scale_m:g} m counts as {LEAST_SCALE_M:g} m there, whatever the file says"
            remarks.append(Remark(path, text, partly=True))
    if config.gate.kind == "hyb-h":
        remarks.append(Remark("gate.d95_m", UNITS_OF_KNN))
        if config.stop.knn_region != "all":
            remarks.append(Remark("stop.knn_region", "theirs is of all points; the box cannot be asked for"))
        if config.gate.geometry_scorer != "b-aware":
            remarks.append(
                Remark(
                    "gate.geometry_scorer",
                    f"{config.gate.geometry_scorer} does not exist there: B-aware flies",
                )
            )
    if config.gate.kind == "learned":
        remarks.append(Remark("gate.learned_policy", "their policies have other features and another schema"))
    return {key.path: values[key.path] for key in SCORING if values.get(key.path) is not None}, remarks


def _scorer(config: MissionConfig) -> tuple[str, str | None]:
    kind = config.gate.kind
    if kind in SCORER_OF_GATE:
        return SCORER_OF_GATE[kind], None
    if kind in MODE_OF_GATE:
        return HYBRID, MODE_OF_GATE[kind]
    known = ", ".join((*SCORER_OF_GATE, *MODE_OF_GATE))
    raise NoSuchGate(f"gate {kind!r} does not exist in photogrammetry_nbv; what can be written is {known}")


def _with_the_flying_scorers_weights(config: MissionConfig) -> MissionConfig:
    """Return ``config`` with both scorers having the shared weights of the one that flies alone, where one does."""
    alone = {"covis": ("covis", "b_aware"), "b-aware": ("b_aware", "covis")}.get(config.gate.kind)
    if alone is None:
        return config
    flies, idle = alone
    return config.with_values(
        {f"{idle}.weights.{name}": getattr(getattr(config, flies).weights, name) for name in _SHARED}
    )


def _geometry_weight(config: MissionConfig) -> tuple[float, list[Remark]]:
    """B-aware's main weight beside Covis's other three, which are shared there.

    Only ratios matter to a ranking, so weights that are Covis's times a factor can be written exactly.
    """
    covis, b_aware = config.covis.weights, config.b_aware.weights
    pairs = {name: (getattr(covis, name), getattr(b_aware, name)) for name in _SHARED}
    scale = next((ours / theirs for ours, theirs in pairs.values() if theirs > 0 and ours > 0), 1.0)
    if all(math.isclose(ours, scale * theirs, rel_tol=1e-9) for ours, theirs in pairs.values()):
        return b_aware.main * scale, []
    return b_aware.main, [
        Remark(
            f"b_aware.weights.{name}",
            f"{theirs:g} cannot be written: both scorers share Covis's {ours:g} there",
        )
        for name, (ours, theirs) in pairs.items()
        if ours != theirs
    ]


def write_mission(
    config: MissionConfig, theirs: Mapping[str, Any] | None = None
) -> tuple[Values, list[Remark]]:
    """A ``unified_mission.yaml`` (flat) that does what ``config`` does; keys that we do not have are as in ``theirs``."""
    values, remarks = _direct(config, MISSION, theirs), list[Remark]()
    values["ring_image_count"] = config.seed.total
    if config.seed.count:
        remarks += _seeds_of_one_turn(config, values)
    elif config.seed.ring_radii_m or config.seed.ring_bearings_deg:
        remarks.append(
            Remark("seed.ring_radii_m", "theirs has one radius, and every ring begins in the north")
        )
    if config.seed.reaim_after:
        remarks.append(Remark("seed.reaim_after", "theirs does not look for the target"))
    remarks += _few_seeds(config)
    values["image_budget"] = config.adaptive_budget
    if config.stop.min_gain_percent:
        remarks.append(Remark("stop.min_gain_percent", "theirs does not ask what the next view would add"))
    values["seed_planner_mode"], values["phase2_planner_mode"] = "stratified", "hybrid"
    east_m, north_m = (t - h for t, h in zip(config.target_m[:2], config.flight.home_m[:2]))
    values["rock_center_x"], values["rock_center_y"] = north_m, east_m
    values["rock_center_z"] = -config.target_m[2]
    # Down is positive there: the upper limit of height is the lower one of z, and the other way round.
    values["min_altitude_ned"] = -config.pool.max_altitude_m
    values["max_altitude_ned"] = -config.pool.min_altitude_m
    values["stopping_criterion"] = CRITERION_OF_OURS.get(config.stop.criterion, "image_budget")
    if config.stop.criterion == "predicted":
        remarks.append(Remark("stop.predicted_percent", "theirs predicts no completeness"))
    values["position_tolerance_z"] = values["position_tolerance_xy"]
    values["max_image_budget"] = max(values["max_image_budget"], config.adaptive_budget)
    if config.stop.criterion in ("both", "knn"):
        remarks.append(Remark("stop.knn_threshold_m", UNITS_OF_KNN))
    return {key.path: values[key.path] for key in MISSION}, remarks


def _seeds_of_one_turn(config: MissionConfig, values: Values) -> list[Remark]:
    """Seeds of ``seed.count`` as rings with as many views; an elevation that none takes is left out."""
    layout_deg = config.seed.layout_deg[: config.seed.count]
    counts = [
        len(range(ring, config.seed.count, len(config.seed.layout_deg))) for ring in range(len(layout_deg))
    ]
    if upper := config.seed.upper_count:
        layout_deg = (config.seed.lowest_deg, config.seed.upper_deg)
        counts = [config.seed.count - upper, upper]
    values["seed_elevation_rings_deg"], values["seed_azimuth_counts"] = list(layout_deg), counts
    if (upper or len(counts) == 1) and not config.seed.start_bearing_deg:
        return []
    text = f"{config.seed.count} seeds about the target are written as rings of {counts}: other azimuths"
    return [Remark("seed.count", text, partly=True)]


def _few_seeds(config: MissionConfig) -> list[Remark]:
    if not config.sparse.ground_features:
        return []
    text = "theirs matches photographs as they are: seeds 30 degrees and more apart may not register"
    return [Remark("sparse.ground_features", text)]


def carried(kind: str, changes: Mapping[str, tuple[MissionConfig, MissionConfig]]) -> list[str]:
    """Return the changed parameters that a file of ``kind`` (a key of `FILES`) carries.

    ``changes``: per changed parameter path a configuration with the change, and the same without it.
    """
    write = dict(zip(FILES, (write_scoring, write_mission)))[kind]
    found = []
    for path, (config, without) in changes.items():
        values, remarks = write(config)
        before, remarks_before = write(without)
        if path in {remark.key for remark in remarks if not remark.partly}:
            continue
        if values != before or path in {remark.key for remark in remarks_before}:
            found.append(path)
    return found


def _direct(config: MissionConfig, keys: Sequence[Key], theirs: Mapping[str, Any] | None) -> Values:
    values: Values = {key.path: key.default for key in keys} | dict(theirs or {})
    for key in keys:
        if key.ours is not None:
            value = _get(config, key.ours)
            values[key.path] = list(value) if isinstance(value, tuple) else value
    return values


def _get(config: MissionConfig, path: str) -> Any:
    node: Any = config
    for part in path.split("."):
        node = getattr(node, part)
    return node
