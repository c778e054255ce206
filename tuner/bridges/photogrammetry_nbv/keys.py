"""Every key of the authors' two files: its default there, and what it is called here.

A key without a counterpart keeps its value when a file is written back, with the reason why here nothing answers to it.
Keys that answer to several of ours, or the other way round, are named here and converted in `writing`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

REPAIR = "repair_weighted_covisibility"
BASELINE_AWARE = "baseline_aware_repair_weighted_covisibility"
HYBRID = "gt_phase_adaptive_hybrid"


@dataclass(frozen=True)
class Key:
    """One key of theirs, by dotted path below ``scorer`` or ``ros__parameters``."""

    path: str
    default: Any  # as published at b8e106c
    # Parameter path with the same meaning and unit; None: converted by hand, or nothing.
    ours: str | None = None
    why_not: str = ""  # why nothing here answers to it; empty where something does


@dataclass(frozen=True)
class Remark:
    """One thing that a conversion does not carry over."""

    key: str  # the parameter path or the key that it is about
    text: str  # what is lost, in one line
    partly: bool = False  # the value is written, though not all that it means here

    def __str__(self) -> str:
        return f"{self.key}: {self.text}"


def _kept(path: str, default: Any, why_not: str) -> Key:
    return Key(path, default, None, why_not)


_UNUSED_THERE = "read and unused there"
_NOT_FLOWN = "belongs to PX4 and ROS"

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
    _kept("gimbal_pitch_rad", -0.54, "the gimbal always aims at the target here"),
    Key("travel_distance_scale_m", 10.0, "shared.d_travel_m"),
    _kept("yaw_change_scale_rad", math.pi, "fixed at pi here (Eq. 3)"),
    Key("novelty_distance_scale_m", 2.0, "shared.d_scale_m"),
    Key("scoring_bbox_half_extent", 2.0, "shared.box_half_extent_m"),
    Key(f"{REPAIR}.target_track_length", 6, "b_aware.target_track_length"),
    Key(f"{REPAIR}.density_k", 5, "b_aware.density_neighbours"),
    _kept(f"{REPAIR}.max_scored_points", 0, "all points are scored here"),
    Key(f"{REPAIR}.weakness_weights.track_support", 0.5, "b_aware.alpha_track"),
    Key(f"{REPAIR}.weakness_weights.local_density", 0.3, "b_aware.alpha_density"),
    Key(f"{REPAIR}.weakness_weights.reprojection", 0.2, "b_aware.alpha_reprojection"),
    # The same five again: B-aware reads them only where the block above is missing.
    Key(f"{BASELINE_AWARE}.target_track_length", 6),
    Key(f"{BASELINE_AWARE}.density_k", 5),
    _kept(f"{BASELINE_AWARE}.max_scored_points", 0, "all points are scored here"),
    Key(f"{BASELINE_AWARE}.weakness_weights.track_support", 0.6),
    Key(f"{BASELINE_AWARE}.weakness_weights.local_density", 0.4),
    Key(f"{BASELINE_AWARE}.weakness_weights.reprojection", 0.0),
    Key(f"{BASELINE_AWARE}.theta_low_deg", 5.0, "b_aware.theta_low_deg"),
    Key(f"{BASELINE_AWARE}.theta_target_deg", 25.0, "b_aware.theta_saturation_deg"),
    _kept(f"{BASELINE_AWARE}.theta_high_deg", 45.0, _UNUSED_THERE),
    Key("hybrid.gate_mode", "heuristic"),
    Key("hybrid.heuristic.budget_fraction_threshold", 0.4, "gate.budget_fraction"),
    Key("hybrid.heuristic.knn_p95_threshold", 0.14, "gate.d95_m"),
    _kept("hybrid.oracle.gt_mesh_path", "", "the true surface is the rock's own here"),
    Key("hybrid.oracle.n_gt_samples", 30000, "gate.oracle_samples"),
    Key("hybrid.oracle.coverage_threshold_m", 0.02, "gate.oracle_threshold_m"),
    # Only their later code (f3120ba) reads it, and takes 0.5 where it is missing.
    Key("hybrid.oracle.quality_credit_weight", 0.0, "gate.oracle_quality_weight"),
    _kept(
        "hybrid.learned_switch.policy_json_path", "", "their policies have other features and another schema"
    ),
    _kept("hybrid.shadow.enabled", True, "both rankings are always recorded here"),
    _kept("hybrid.shadow.log_top_k", 5, "all candidates are recorded here"),
)

MISSION = (
    _kept("output_root", "~/photogrammetry_NBV/data/photogrammetry", "where their runs go"),
    Key("seed_radius_m", 4.0, "seed.radius_m"),
    Key("ring_image_count", 24),  # the sum of seed_azimuth_counts
    _kept("seed_min_elevation_deg", 5.0, "of the mode fibonacci"),
    _kept("seed_max_elevation_deg", 30.0, "of the mode fibonacci"),
    Key("seed_planner_mode", "stratified"),
    Key("seed_elevation_rings_deg", [15.0, 22.0, 29.0, 36.0], "seed.ring_elevations_deg"),
    Key("seed_azimuth_counts", [8, 6, 6, 4], "seed.ring_azimuth_counts"),
    Key("rock_center_x", 0.0),  # north of take-off; with the next two: target_m and flight.home_m
    Key("rock_center_y", 8.0),  # east of it
    Key("rock_center_z", -0.8),  # down
    Key("image_budget", 40, "stop.adaptive_budget"),
    _kept("max_image_budget", 55, "a hard limit that the budget never reaches"),
    Key("stopping_criterion", "image_budget"),
    Key("knn_distance_threshold", 0.003, "stop.knn_threshold_m"),
    _kept("raw_candidate_count", 800, "of the mode fibonacci"),
    Key("target_candidate_count", 200, "pool.max_candidates"),
    Key("candidate_radius_m", 3.5, "pool.radius_m"),
    Key("candidate_min_spacing_m", 0.3, "pool.min_spacing_m"),
    _kept("min_elevation_deg", 5.0, "of the mode fibonacci"),
    _kept("max_elevation_deg", 55.0, "of the mode fibonacci"),
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
    _kept("offboard_rate_hz", 10.0, _NOT_FLOWN),
    _kept("setpoint_warmup_cycles", 20, _NOT_FLOWN),
    Key("position_tolerance_xy", 0.35, "flight.arrival_tolerance_m"),
    Key("position_tolerance_z", 0.35),  # the same
    Key("settle_time_sec", 2.0, "flight.settle_s"),
    _kept("gimbal_pitch_rad", -0.54, "the gimbal always aims at the target here"),
    _kept("gimbal_yaw_rad", 0.0, "the gimbal always aims at the target here"),
    _kept("image_format", "jpg", "photographs are lossless here"),
    _kept("land_after_budget", True, "a mission always lands here"),
    _kept("eval_bbox_half_extent", 6.0, _UNUSED_THERE),
    _kept("colmap_bin", "colmap", "COLMAP is a library here"),
    _kept("colmap_script_dir", "", "COLMAP is a library here"),
    _kept("colmap_config_path", "", "COLMAP is a library here"),
    _kept("scoring_config_path", "", "given when their mission starts"),
    _kept("offboard_control_mode_topic", "/fmu/in/offboard_control_mode", _NOT_FLOWN),
    _kept("trajectory_setpoint_topic", "/fmu/in/trajectory_setpoint", _NOT_FLOWN),
    _kept("vehicle_command_topic", "/fmu/in/vehicle_command", _NOT_FLOWN),
    _kept("local_position_topic", "/fmu/out/vehicle_local_position_v1", _NOT_FLOWN),
    _kept("vehicle_status_topic", "/fmu/out/vehicle_status_v3", _NOT_FLOWN),
    _kept("image_topic", "/rgbd/image", _NOT_FLOWN),
    _kept("camera_info_topic", "/rgbd/camera_info", _NOT_FLOWN),
    _kept("gimbal_pitch_topic", "/gimbal/pitch", _NOT_FLOWN),
    _kept("gimbal_yaw_topic", "/gimbal/yaw", _NOT_FLOWN),
)

# The keys that lead to the parameters in each file.
FILES = {
    "scoring.yaml": (("scorer",), SCORING),
    "unified_mission.yaml": (("/**", "ros__parameters"), MISSION),
}

# Their distance scales are never less than this, whatever the file says.
LEAST_SCALE_M = 1.0
SCALES = {"shared.d_scale_m": "novelty_distance_scale_m", "shared.d_travel_m": "travel_distance_scale_m"}

# What flies there, by scorer name or by gate mode of the hybrid, and here.
SCORER_OF_GATE = {"covis": "covisibility", "b-aware": BASELINE_AWARE}
MODE_OF_GATE = {"hyb-h": "heuristic", "hyb-o": "oracle", "learned": "learned_switch"}
CRITERION_OF_OURS = {"budget": "image_budget", "knn": "knn_distance", "both": "both"}
