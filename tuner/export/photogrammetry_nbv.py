"""Conversion of a configuration to the authors' files, ``scoring.yaml`` and ``unified_mission.yaml``.

Facts about their keys come from the public repository ``photogrammetry_nbv`` at commit b8e106c; nothing of its code is here.
A key without a counterpart keeps its value, that of ``published``, when a file is written. Where one key corresponds
to several parameters, or the other way round, the tables name them and the code below converts them one by one.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping
from dataclasses import dataclass
from operator import attrgetter
from pathlib import Path
from typing import Any

from nbv.config import MissionConfig
from nbv.errors import UserError
from nbv.safe_files import read_yaml, to_yaml
from tuner.problem.goal import by_dotted_path

FlatValues = dict[str, Any]
PUBLISHED = Path(__file__).with_name("published")
COLMAP_UNITS = "it is in COLMAP's units there, whose length in metres is unknown before the flight"
_SHARED = ("nov", "move", "ang")
REPAIR = "repair_weighted_covisibility"
BASELINE_AWARE = "baseline_aware_repair_weighted_covisibility"
HYBRID = "gt_phase_adaptive_hybrid"


@dataclass(frozen=True)
class Remark:
    """One thing that a conversion does not carry over."""

    key: str  # the parameter path or the key that it is about
    text: str  # what is lost, in one line
    partly: bool = False  # the value is written, though not all that it means here

    def __str__(self) -> str:
        return f"{self.key}: {self.text}"


# Where the keys lie in each file, and the parameters with the same meaning and unit by key.
FILES = {"scoring.yaml": ("scorer",), "unified_mission.yaml": ("/**", "ros__parameters")}
SCORING = {
    "weights.covisibility": "covis.weights.main",
    "weights.novelty": "covis.weights.nov",
    "weights.movement_cost": "covis.weights.move",
    "weights.angular_separation_penalty": "covis.weights.ang",
    "min_track_length": "shared.min_track_length",
    "min_angular_separation_deg": "shared.theta_min_deg",
    "travel_distance_scale_m": "shared.d_travel_m",
    "novelty_distance_scale_m": "shared.d_scale_m",
    "scoring_bbox_half_extent": "shared.box_half_extent_m",
    f"{REPAIR}.target_track_length": "b_aware.target_track_length",
    f"{REPAIR}.density_k": "b_aware.density_neighbours",
    f"{REPAIR}.weakness_weights.track_support": "b_aware.alpha_track",
    f"{REPAIR}.weakness_weights.local_density": "b_aware.alpha_density",
    f"{REPAIR}.weakness_weights.reprojection": "b_aware.alpha_reprojection",
    f"{BASELINE_AWARE}.theta_low_deg": "b_aware.theta_low_deg",
    f"{BASELINE_AWARE}.theta_target_deg": "b_aware.theta_saturation_deg",
    "hybrid.heuristic.budget_fraction_threshold": "gate.budget_fraction",
    "hybrid.oracle.n_gt_samples": "gate.oracle_samples",
    "hybrid.oracle.coverage_threshold_m": "gate.oracle_threshold_m",
    "hybrid.oracle.quality_credit_weight": "gate.oracle_quality_weight",
}
MISSION = {
    "seed_radius_m": "seed.radius_m",
    "seed_elevation_rings_deg": "seed.ring_elevations_deg",
    "seed_azimuth_counts": "seed.ring_azimuth_counts",
    "target_candidate_count": "pool.max_candidates",
    "candidate_radius_m": "pool.radius_m",
    "candidate_min_spacing_m": "pool.min_spacing_m",
    "max_candidate_travel_m": "pool.max_travel_m",
    "phase2_lateral_elevations_deg": "pool.lateral_elevations_deg",
    "phase2_upper_elevations_deg": "pool.upper_elevations_deg",
    "phase2_lateral_candidate_count": "pool.lateral_count",
    "phase2_upper_candidate_count": "pool.upper_count",
    "azimuth_sector_count": "pool.azimuth_sectors",
    "adaptive_revisit_exclusion_m": "pool.revisit_exclusion_m",
    "takeoff_altitude": "flight.takeoff_altitude_m",
    "position_tolerance_xy": "flight.arrival_tolerance_m",
    "settle_time_sec": "flight.settle_s",
}

# What each file has a place for: parameters that are keys themselves, and those that the code below converts.
PARAMETERS = {
    "scoring.yaml": {
        *SCORING.values(),
        *("gate.kind", *(f"b_aware.weights.{name}" for name in ("main", *_SHARED))),
    },
    "unified_mission.yaml": {
        *MISSION.values(),
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
    tree: dict[str, Any] = {}
    for path, value in values.items():
        node = tree
        *parents, leaf = path.split(".")
        for parent in parents:
            node = node.setdefault(parent, {})
        node[leaf] = value
    for part in reversed(FILES[kind]):
        tree = {part: tree}
    return to_yaml(tree, default_flow_style=None, width=100)


@functools.cache
def published(kind: str) -> Mapping[str, Any]:
    """Return the values of one of their files as published, by dotted path."""
    tree = read_yaml(PUBLISHED / kind)
    for part in FILES[kind]:
        tree = tree[part]
    return by_dotted_path(tree)


# -- values ----------------------------------------------------------------------------------------------------


def write_scoring(config: MissionConfig) -> tuple[FlatValues, list[Remark]]:
    """Return a ``scoring.yaml`` (flat) that does what ``config`` does; keys that we do not have are as published.

    Raises `UserError`: the gate, or a scorer, does not exist there.
    """
    if alone := {"covis": ("covis", "b_aware"), "b-aware": ("b_aware", "covis")}.get(config.gate.kind):
        # The shared weights are those of the scorer that is used.
        used, idle = alone
        weights = getattr(config, used).weights
        config = config.with_values({f"{idle}.weights.{name}": getattr(weights, name) for name in _SHARED})
    values, remarks = {**published("scoring.yaml"), **_values(config, SCORING)}, list[Remark]()
    kind = config.gate.kind
    if kind in MODE_OF_GATE:
        values["name"], values["hybrid.gate_mode"] = HYBRID, MODE_OF_GATE[kind]
    elif kind in SCORER_OF_GATE:
        values["name"] = SCORER_OF_GATE[kind]
    else:
        known = ", ".join((*SCORER_OF_GATE, *MODE_OF_GATE))
        raise UserError(f"gate {kind!r} does not exist in photogrammetry_nbv; what can be written is {known}")
    values["weights.geometry_aware_repair"], more = _geometry_weight(config)
    remarks += more
    for name in ("target_track_length", "density_k"):
        values[f"{BASELINE_AWARE}.{name}"] = values[f"{REPAIR}.{name}"]
    for name in ("track_support", "local_density", "reprojection"):
        values[f"{BASELINE_AWARE}.weakness_weights.{name}"] = values[f"{REPAIR}.weakness_weights.{name}"]
    for path, key in SCALES.items():
        if (scale_m := attrgetter(path)(config)) < LEAST_SCALE_M:
            values[key] = LEAST_SCALE_M
            text = f"{scale_m:g} m counts as {LEAST_SCALE_M:g} m there, whatever the file says"
            remarks.append(Remark(path, text, partly=True))
    heuristic, scorer = kind == "hyb-h", config.gate.geometry_scorer
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
    return values, remarks


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


def write_mission(config: MissionConfig) -> tuple[FlatValues, list[Remark]]:
    """A ``unified_mission.yaml`` (flat) that does what ``config`` does; keys that we do not have are as published."""
    values, stop = {**published("unified_mission.yaml"), **_values(config, MISSION)}, config.stop
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
    return values, remarks


def _not_written(values: FlatValues, key: str) -> str:
    """The remark on a distance that is not written, since their file has it in units of the reconstruction."""
    return f"{key} stays {values[key]:g}: {COLMAP_UNITS}"


def _remarks(*about: tuple[str, bool, str]) -> list[Remark]:
    """The remarks whose condition holds, of (parameter, condition, what is lost)."""
    return [Remark(path, text) for path, holds, text in about if holds]


def _values(config: MissionConfig, parameters: Mapping[str, str]) -> FlatValues:
    """Return the values of ``config`` by their keys."""
    values = {key: attrgetter(path)(config) for key, path in parameters.items()}
    return {key: list(value) if isinstance(value, tuple) else value for key, value in values.items()}
