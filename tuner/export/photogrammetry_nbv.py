"""Conversion of a configuration to the authors' files, ``scoring.yaml`` and ``unified_mission.yaml``.

Facts about their keys come from the public repository ``photogrammetry_nbv`` at commit b8e106c; nothing of its code is here.
A key without a counterpart keeps its value when a file is written, and a comment says why it has none. Where one key corresponds
to several parameters, or the other way round, the tables name them and the code below converts them one by one.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import Any

from nbv.config import MissionConfig
from nbv.errors import UserError
from nbv.safe_files import to_yaml

Values = dict[str, Any]
COLMAP_UNITS = "it is in COLMAP's units there, whose length in metres is unknown before the flight"
_SHARED = ("nov", "move", "ang")
REPAIR = "repair_weighted_covisibility"
BASELINE_AWARE = "baseline_aware_repair_weighted_covisibility"
HYBRID = "gt_phase_adaptive_hybrid"


@dataclass(frozen=True)
class Key:
    """One key of the authors' files, by dotted path below ``scorer`` or ``ros__parameters``."""

    path: str
    default: Any  # as published at b8e106c
    # Path of the parameter with the same meaning and unit; None where there is none.
    parameter: str | None = None


@dataclass(frozen=True)
class Remark:
    """One thing that a conversion does not carry over."""

    key: str  # the parameter path or the key that it is about
    text: str  # what is lost, in one line
    partly: bool = False  # the value is written, though not all that it means here

    def __str__(self) -> str:
        return f"{self.key}: {self.text}"


SCORING = (
    Key("name", HYBRID),  # with hybrid.gate_mode: gate.kind
    Key("weights.covisibility", 1.0, "covis.weights.main"),
    Key("weights.novelty", 1.2, "covis.weights.nov"),
    Key("weights.movement_cost", 0.1, "covis.weights.move"),
    Key("weights.angular_separation_penalty", 0.4, "covis.weights.ang"),
    Key("weights.geometry_aware_repair", None),  # optional: B-aware's main weight alone
    Key("weights.repair", None),  # optional: the same, where the former is missing
    Key("min_track_length", 2, "shared.min_track_length"),
    Key("min_angular_separation_deg", 20.0, "shared.theta_min_deg"),
    Key("gimbal_pitch_rad", -0.54),  # the gimbal always aims at the target here
    Key("travel_distance_scale_m", 10.0, "shared.d_travel_m"),
    Key("yaw_change_scale_rad", math.pi),  # fixed at pi here (Eq. 3)
    Key("novelty_distance_scale_m", 2.0, "shared.d_scale_m"),
    Key("scoring_bbox_half_extent", 2.0, "shared.box_half_extent_m"),
    Key(f"{REPAIR}.target_track_length", 6, "b_aware.target_track_length"),
    Key(f"{REPAIR}.density_k", 5, "b_aware.density_neighbours"),
    Key(f"{REPAIR}.max_scored_points", 0),  # all points are scored here
    Key(f"{REPAIR}.weakness_weights.track_support", 0.5, "b_aware.alpha_track"),
    Key(f"{REPAIR}.weakness_weights.local_density", 0.3, "b_aware.alpha_density"),
    Key(f"{REPAIR}.weakness_weights.reprojection", 0.2, "b_aware.alpha_reprojection"),
    # The same five again: B-aware reads them only where the block above is missing.
    Key(f"{BASELINE_AWARE}.target_track_length", 6),
    Key(f"{BASELINE_AWARE}.density_k", 5),
    Key(f"{BASELINE_AWARE}.max_scored_points", 0),  # all points are scored here
    Key(f"{BASELINE_AWARE}.weakness_weights.track_support", 0.6),
    Key(f"{BASELINE_AWARE}.weakness_weights.local_density", 0.4),
    Key(f"{BASELINE_AWARE}.weakness_weights.reprojection", 0.0),
    Key(f"{BASELINE_AWARE}.theta_low_deg", 5.0, "b_aware.theta_low_deg"),
    Key(f"{BASELINE_AWARE}.theta_target_deg", 25.0, "b_aware.theta_saturation_deg"),
    Key(f"{BASELINE_AWARE}.theta_high_deg", 45.0),  # read and unused there
    Key("hybrid.gate_mode", "heuristic"),
    Key("hybrid.heuristic.budget_fraction_threshold", 0.4, "gate.budget_fraction"),
    Key("hybrid.heuristic.knn_p95_threshold", 0.14),  # COLMAP's units
    Key("hybrid.oracle.gt_mesh_path", ""),  # the true surface is the rock's own here
    Key("hybrid.oracle.n_gt_samples", 30000, "gate.oracle_samples"),
    Key("hybrid.oracle.coverage_threshold_m", 0.02, "gate.oracle_threshold_m"),
    # Only their later code (f3120ba) reads it, and takes 0.5 where it is missing.
    Key("hybrid.oracle.quality_credit_weight", 0.0, "gate.oracle_quality_weight"),
    Key("hybrid.learned_switch.policy_json_path", ""),  # no such gate here
    Key("hybrid.shadow.enabled", True),  # both rankings are always recorded here
    Key("hybrid.shadow.log_top_k", 5),  # all candidates are recorded here
)

MISSION = (
    Key("output_root", "~/photogrammetry_NBV/data/photogrammetry"),  # where their runs go
    Key("seed_radius_m", 4.0, "seed.radius_m"),
    Key("ring_image_count", 24),  # the sum of seed_azimuth_counts
    Key("seed_min_elevation_deg", 5.0),  # of the mode fibonacci
    Key("seed_max_elevation_deg", 30.0),  # of the mode fibonacci
    Key("seed_planner_mode", "stratified"),
    Key("seed_elevation_rings_deg", [15.0, 22.0, 29.0, 36.0], "seed.ring_elevations_deg"),
    Key("seed_azimuth_counts", [8, 6, 6, 4], "seed.ring_azimuth_counts"),
    Key("rock_center_x", 0.0),  # north of take-off; with the next two: target_m and flight.home_m
    Key("rock_center_y", 8.0),  # east of it
    Key("rock_center_z", -0.8),  # down
    Key("image_budget", 40),
    Key("max_image_budget", 55),  # a hard limit that the budget never reaches
    Key("stopping_criterion", "image_budget"),
    Key("knn_distance_threshold", 0.003),  # COLMAP's units
    Key("raw_candidate_count", 800),  # of the mode fibonacci
    Key("target_candidate_count", 200, "pool.max_candidates"),
    Key("candidate_radius_m", 3.5, "pool.radius_m"),
    Key("candidate_min_spacing_m", 0.3, "pool.min_spacing_m"),
    Key("min_elevation_deg", 5.0),  # of the mode fibonacci
    Key("max_elevation_deg", 55.0),  # of the mode fibonacci
    Key("min_altitude_ned", -20.0),  # down is positive: minus pool.max_altitude_m
    Key("max_altitude_ned", -1.5),  # minus pool.min_altitude_m
    Key("max_candidate_travel_m", 40.0, "pool.max_travel_m"),
    Key("phase2_planner_mode", "hybrid"),
    Key("phase2_lateral_elevations_deg", [10.0, 15.0, 25.0, 35.0], "pool.lateral_elevations_deg"),
    Key("phase2_upper_elevations_deg", [35.0, 45.0, 55.0], "pool.upper_elevations_deg"),
    Key("phase2_lateral_candidate_count", 120, "pool.lateral_count"),
    Key("phase2_upper_candidate_count", 50, "pool.upper_count"),
    Key("azimuth_sector_count", 8, "pool.azimuth_sectors"),
    Key("adaptive_revisit_exclusion_m", 0.6, "pool.revisit_exclusion_m"),
    Key("takeoff_altitude", 3.0, "flight.takeoff_altitude_m"),
    Key("offboard_rate_hz", 10.0),  # belongs to PX4 and ROS
    Key("setpoint_warmup_cycles", 20),  # belongs to PX4 and ROS
    Key("position_tolerance_xy", 0.35, "flight.arrival_tolerance_m"),
    Key("position_tolerance_z", 0.35),  # the same
    Key("settle_time_sec", 2.0, "flight.settle_s"),
    Key("gimbal_pitch_rad", -0.54),  # the gimbal always aims at the target here
    Key("gimbal_yaw_rad", 0.0),  # the gimbal always aims at the target here
    Key("image_format", "jpg"),  # photographs are lossless here
    Key("land_after_budget", True),  # a mission always lands here
    Key("eval_bbox_half_extent", 6.0),  # read and unused there
    Key("colmap_bin", "colmap"),  # COLMAP is a library here
    Key("colmap_script_dir", ""),  # COLMAP is a library here
    Key("colmap_config_path", ""),  # COLMAP is a library here
    Key("scoring_config_path", ""),  # given when their mission starts
    Key("offboard_control_mode_topic", "/fmu/in/offboard_control_mode"),  # belongs to PX4 and ROS
    Key("trajectory_setpoint_topic", "/fmu/in/trajectory_setpoint"),  # belongs to PX4 and ROS
    Key("vehicle_command_topic", "/fmu/in/vehicle_command"),  # belongs to PX4 and ROS
    Key("local_position_topic", "/fmu/out/vehicle_local_position_v1"),  # belongs to PX4 and ROS
    Key("vehicle_status_topic", "/fmu/out/vehicle_status_v3"),  # belongs to PX4 and ROS
    Key("image_topic", "/rgbd/image"),  # belongs to PX4 and ROS
    Key("camera_info_topic", "/rgbd/camera_info"),  # belongs to PX4 and ROS
    Key("gimbal_pitch_topic", "/gimbal/pitch"),  # belongs to PX4 and ROS
    Key("gimbal_yaw_topic", "/gimbal/yaw"),  # belongs to PX4 and ROS
)

# The keys that lead to the parameters in each file.
FILES = {
    "scoring.yaml": (("scorer",), SCORING),
    "unified_mission.yaml": (("/**", "ros__parameters"), MISSION),
}

# What each file has a place for: parameters that are keys themselves, and those that the code below converts.
PARAMETERS = {
    "scoring.yaml": {
        *(key.parameter for key in SCORING if key.parameter),
        *("gate.kind", *(f"b_aware.weights.{name}" for name in ("main", *_SHARED))),
    },
    "unified_mission.yaml": {
        *(key.parameter for key in MISSION if key.parameter),
        *("photographs", "seeds", "seed.layout", "seed.lowest_deg", "seed.span_deg", "seed.upper_share"),
        *("target_m", "flight.home_m", "pool.min_altitude_m", "pool.max_altitude_m"),
    },
}
# Their distance scales are never less than this, whatever the file says.
LEAST_SCALE_M = 1.0
SCALES = {"shared.d_scale_m": "novelty_distance_scale_m", "shared.d_travel_m": "travel_distance_scale_m"}

# What chooses views there, by scorer name or by gate mode of the hybrid, and here.
SCORER_OF_GATE = {"covis": "covisibility", "b-aware": BASELINE_AWARE}
MODE_OF_GATE = {"hyb-h": "heuristic", "hyb-o": "oracle"}


def write_text(values: Mapping[str, Any], kind: str) -> str:
    """YAML text of one of their files from values by dotted path."""
    prefix, _ = FILES[kind]
    tree: dict[str, Any] = {}
    for path, value in values.items():
        node = tree
        *parents, leaf = path.split(".")
        for parent in parents:
            node = node.setdefault(parent, {})
        node[leaf] = value
    for part in reversed(prefix):
        tree = {part: tree}
    return to_yaml(tree, default_flow_style=None, width=100)


# -- values ----------------------------------------------------------------------------------------------------


def write_scoring(config: MissionConfig) -> tuple[Values, list[Remark]]:
    """Return a ``scoring.yaml`` (flat) that does what ``config`` does; keys that we do not have are as published.

    Raises `UserError`: the gate, or a scorer, does not exist there.
    """
    config = _with_weights_of_selected_scorer(config)
    values, remarks = _direct(config, SCORING), list[Remark]()
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
        if (scale_m := attrgetter(path)(config)) < LEAST_SCALE_M:
            values[key] = LEAST_SCALE_M
            text = f"{scale_m:g} m counts as {LEAST_SCALE_M:g} m there, whatever the file says"
            remarks.append(Remark(path, text, partly=True))
    heuristic, scorer = config.gate.kind == "hyb-h", config.gate.geometry_scorer
    remarks += _remarks(
        ("gate.d95_m", heuristic, _not_written(values, "hybrid.heuristic.knn_p95_threshold")),
        (
            "stop.knn_region",
            heuristic and config.stop.knn_region != "all",
            "theirs is of all points; the box cannot be asked for",
        ),
        (
            "gate.geometry_scorer",
            heuristic and scorer != "b-aware",
            f"{scorer} does not exist there, so B-aware takes its place",
        ),
    )
    return {key.path: values[key.path] for key in SCORING if values.get(key.path) is not None}, remarks


def _scorer(config: MissionConfig) -> tuple[str, str | None]:
    kind = config.gate.kind
    if kind in SCORER_OF_GATE:
        return SCORER_OF_GATE[kind], None
    if kind in MODE_OF_GATE:
        return HYBRID, MODE_OF_GATE[kind]
    known = ", ".join((*SCORER_OF_GATE, *MODE_OF_GATE))
    raise UserError(f"gate {kind!r} does not exist in photogrammetry_nbv; what can be written is {known}")


def _with_weights_of_selected_scorer(config: MissionConfig) -> MissionConfig:
    """Return ``config`` with both scorers having the shared weights of the one that is used alone, where one does."""
    alone = {"covis": ("covis", "b_aware"), "b-aware": ("b_aware", "covis")}.get(config.gate.kind)
    if alone is None:
        return config
    used, idle = alone
    return config.with_values(
        {f"{idle}.weights.{name}": getattr(getattr(config, used).weights, name) for name in _SHARED}
    )


def _geometry_weight(config: MissionConfig) -> tuple[float, list[Remark]]:
    """B-aware's main weight beside Covis's other three, which are shared there.

    Only ratios matter to a ranking, so weights that are Covis's times a factor can be written exactly.
    """
    covis, b_aware = config.covis.weights, config.b_aware.weights
    pairs = {name: (getattr(covis, name), getattr(b_aware, name)) for name in _SHARED}
    scale = next(
        (of_covis / of_b_aware for of_covis, of_b_aware in pairs.values() if of_b_aware > 0 and of_covis > 0),
        1.0,
    )
    if all(
        math.isclose(of_covis, scale * of_b_aware, rel_tol=1e-9) for of_covis, of_b_aware in pairs.values()
    ):
        return b_aware.main * scale, []
    return b_aware.main, [
        Remark(
            f"b_aware.weights.{name}",
            f"{of_b_aware:g} cannot be written: both scorers share Covis's {of_covis:g} there",
        )
        for name, (of_covis, of_b_aware) in pairs.items()
        if of_covis != of_b_aware
    ]


def write_mission(config: MissionConfig) -> tuple[Values, list[Remark]]:
    """A ``unified_mission.yaml`` (flat) that does what ``config`` does; keys that we do not have are as published."""
    values, stop = _direct(config, MISSION), config.stop
    values["ring_image_count"] = config.seeds
    values["seed_elevation_rings_deg"] = [elevation_deg for elevation_deg, _ in config.seed_rings]
    values["seed_azimuth_counts"] = [number for _, number in config.seed_rings]
    by_distance = stop.criterion == "both"
    remarks = _remarks(
        ("seed.recentre_after", bool(config.seed.recentre_after), "theirs does not look for the target"),
        (
            "sparse.ground_features",
            bool(config.sparse.ground_features),
            "theirs matches photographs as they are: seeds 30 degrees and more apart may not register",
        ),
        ("stop.predicted_percent", stop.criterion == "predicted", "theirs predicts no completeness"),
        ("stop.knn_threshold_m", by_distance, _not_written(values, "knn_distance_threshold")),
        (
            "stop.criterion",
            by_distance,
            f"both asks for that distance, so stopping_criterion stays {values['stopping_criterion']}",
        ),
    )
    values["image_budget"] = config.planned_views
    values["seed_planner_mode"], values["phase2_planner_mode"] = "stratified", "hybrid"
    east_m, north_m = (t - h for t, h in zip(config.target_m[:2], config.flight.home_m[:2]))
    values["rock_center_x"], values["rock_center_y"] = north_m, east_m
    values["rock_center_z"] = -config.target_m[2]
    # Down is positive there: the upper limit of height is the lower one of z, and the other way round.
    values["min_altitude_ned"] = -config.pool.max_altitude_m
    values["max_altitude_ned"] = -config.pool.min_altitude_m
    values["position_tolerance_z"] = values["position_tolerance_xy"]
    values["max_image_budget"] = max(values["max_image_budget"], config.planned_views)
    return {key.path: values[key.path] for key in MISSION}, remarks


def _not_written(values: Values, key: str) -> str:
    """The remark on a distance that is not written, since their file has it in units of the reconstruction."""
    return f"{key} stays {values[key]:g}: {COLMAP_UNITS}"


def _remarks(*about: tuple[str, bool, str]) -> list[Remark]:
    """The remarks whose condition holds, of (parameter, condition, what is lost)."""
    return [Remark(path, text) for path, holds, text in about if holds]


def _direct(config: MissionConfig, keys: Sequence[Key]) -> Values:
    values: Values = {key.path: key.default for key in keys}
    for key in keys:
        if key.parameter is not None:
            value = attrgetter(key.parameter)(config)
            values[key.path] = list(value) if isinstance(value, tuple) else value
    return values
