"""What one mission is made of: frozen, typed, validated, with units in the names.

Every default below is the paper's value unless the comment says otherwise; preset ``paper`` differs from them only
in `ECONOMIES`.
A parameter path such as ``gate.budget_fraction`` or ``covis.weights.nov`` names one field;
search spaces and command-line overrides use these paths.
"""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import json
import types
import typing
from dataclasses import dataclass, field
from typing import Any, Literal

from nbv.errors import UserError

GATE_KINDS = (
    "covis", "b-aware", "hyb-h", "hyb-o", "greedy-oracle", "learned",
    "random", "novelty-only", "movement-only", "uniform-coverage",
)  # fmt: skip
LATER = {"later": True}  # of a field that came after missions had been flown; see MissionConfig.digest
GateKind = Literal[
    "covis", "b-aware", "hyb-h", "hyb-o", "greedy-oracle", "learned",
    "random", "novelty-only", "movement-only", "uniform-coverage",
]  # fmt: skip


@dataclass(frozen=True)
class CameraConfig:
    """Pinhole camera without distortion; pixel centres at half-integers, as in COLMAP."""

    width_px: int = 640
    height_px: int = 480
    focal_px: float = 465.7412  # hfov 1.204 rad at 640 px, the paper's simulated camera


@dataclass(frozen=True)
class SceneConfig:
    """Light, ground and sensor."""

    backend: Literal["raycast", "gl"] = "raycast"
    sun_direction: tuple[float, float, float] = (0.001, 0.625, -0.78)  # direction the light travels, ENU
    sun_irradiance: float = 0.904
    ambient: float = 0.4
    sky_grey: float = 0.7
    ground_seed: int = 0
    read_noise_dn: float = 1.0  # Gaussian, 8-bit digital numbers
    shot_noise_dn: float = 1.5  # standard deviation at full scale; grows with the square root of the signal


@dataclass(frozen=True)
class FlightConfig:
    """X500-class multirotor limits and the paper's arrival test."""

    home_m: tuple[float, float, float] = (0.0, -8.0, 0.0)
    takeoff_altitude_m: float = 3.0
    max_speed_m_s: float = 5.0
    max_climb_m_s: float = 2.0
    max_acceleration_m_s2: float = 3.0
    max_jerk_m_s3: float = 8.0
    max_yaw_rate_rad_s: float = 0.8
    max_yaw_acceleration_rad_s2: float = 1.5
    max_yaw_jerk_rad_s3: float = 6.0
    arrival_tolerance_m: float = 0.35  # per axis, paper's code
    settle_s: float = 2.0
    # Ours: straight legs through this upright cylinder around the target get a detour.
    keep_out_radius_m: float = 1.3
    keep_out_height_m: float = 2.2  # above the ground
    min_camera_altitude_m: float = 0.3  # arrival errors never take the camera below


@dataclass(frozen=True)
class SeedConfig:
    """Phase 1: stratified ring orbit."""

    radius_m: float = 4.0
    ring_elevations_deg: tuple[float, ...] = (15.0, 22.0, 29.0, 36.0)
    ring_azimuth_counts: tuple[int, ...] = (8, 6, 6, 4)


@dataclass(frozen=True)
class PoolConfig:
    """Phase 2: two-band candidate pool and its feasibility filters."""

    radius_m: float = 3.5
    lateral_elevations_deg: tuple[float, ...] = (10.0, 15.0, 25.0, 35.0)
    lateral_count: int = 120  # inverse-rank weights over the lateral rings
    upper_elevations_deg: tuple[float, ...] = (35.0, 45.0, 55.0)
    upper_count: int = 50
    min_altitude_m: float = 1.3  # lets the 10 degree ring (1.408 m) be flown, as the text says
    max_altitude_m: float = 20.0
    max_travel_m: float = 40.0
    min_spacing_m: float = 0.3
    revisit_exclusion_m: float = 0.6  # against adaptive captures only
    azimuth_sectors: int = 8
    max_candidates: int = 200


@dataclass(frozen=True)
class StopConfig:
    """Phase 2 ends when the budget is used or the sparse cloud has converged."""

    adaptive_budget: int = 40  # captures after the seeds; an image that does not register counts too
    criterion: Literal["both", "budget", "knn"] = "both"  # both = whichever comes first
    knn_threshold_m: float = 0.003
    knn_neighbours: int = 5  # distance to the 5th neighbour
    knn_region: Literal["all", "box"] = "all"


@dataclass(frozen=True)
class Weights:
    """Weights of Eq. 1; only their ratios matter to the ranking."""

    main: float = 1.0
    nov: float = 1.2
    move: float = 0.1
    ang: float = 0.4


@dataclass(frozen=True)
class SharedTermsConfig:
    """Scales of Eq. 2 to 4 and the point set of Eq. 5 and 8."""

    d_scale_m: float = 2.0
    d_travel_m: float = 10.0
    theta_min_deg: float = 20.0
    box_half_extent_m: float = 2.0
    min_track_length: int = 2


@dataclass(frozen=True)
class VisibilityConfig:
    """Which points count as visible: all in the image, or also facing the candidate and not hidden."""

    mode: Literal["frustum", "occlusion"] = "frustum"


@dataclass(frozen=True)
class CovisConfig:
    weights: Weights = field(default_factory=Weights)


@dataclass(frozen=True)
class BAwareConfig:
    """Eq. 6 and 7."""

    weights: Weights = field(default_factory=Weights)
    alpha_track: float = 0.6
    alpha_density: float = 0.4
    alpha_reprojection: float = 0.0  # 0.2 in the authors' public code (with 0.5 / 0.3)
    target_track_length: int = 6
    density_neighbours: int = 5
    theta_low_deg: float = 5.0
    theta_saturation_deg: float = 25.0
    # Ours: "matchable" asks which surface still lacks matchable views, instead of Eq. 6 to 8.
    main_term: Literal["repair", "matchable"] = field(default="repair", metadata=LATER)
    matchable_views: int = field(
        default=6, metadata=LATER
    )  # that must match one another on a piece of surface


@dataclass(frozen=True)
class GateConfig:
    """Which ranking is flown (Eq. 9 for ``hyb-h``)."""

    kind: GateKind = "hyb-h"
    budget_fraction: float = 0.4
    d95_m: float = 0.14
    oracle_coverage: Literal["reconstruction", "seen", "matchable", "paper-code"] = "reconstruction"
    oracle_samples: int = 30_000
    oracle_threshold_m: float = 0.02
    oracle_matchable_views: int = 3  # views that must see a sample, for oracle_coverage="matchable"
    learned_policy: str = ""  # path of a policy JSON, for kind="learned"; empty: the shipped policy


@dataclass(frozen=True)
class SparseConfig:
    """Features, matching, incremental mapping, alignment."""

    max_features: int = 8192
    first_octave: int = -1
    peak_threshold: float = 0.0066  # COLMAP's default, 0.02 / 3
    match_ratio: float = 0.8
    max_pair_angle_deg: float = 130.0  # pairs whose viewing directions differ more are not matched
    # Earlier photographs to match a new one with, nearest directions first; 0 = all. Ours: the paper matches all, with
    # the same outcome along the same views (docs/performance.md, "Fewer pairs").
    max_pairs: int = 12
    min_inliers: int = 15
    min_ransac_trials: int = field(default=100, metadata=LATER)  # of two-view verification; COLMAP's default
    global_ba_interval: int = 5  # captures between global bundle adjustments
    # Photographs in a local adjustment, the new one included, and how often at most it is repeated; COLMAP's defaults.
    local_ba_images: int = field(default=6, metadata=LATER)
    local_ba_rounds: int = field(default=2, metadata=LATER)
    # Solver iterations of one adjustment after the seed model, at most; 0: COLMAP's limits, 25 and 50.
    local_ba_iterations: int = field(default=0, metadata=LATER)
    global_ba_iterations: int = field(default=0, metadata=LATER)
    # Pairs whose matches an update between global adjustments sees: all, or those of the new photograph's partners.
    update_pairs: Literal["all", "near"] = field(default="all", metadata=LATER)
    max_alignment_rms_m: float = 0.10  # beyond this the model is wrong, not noisy
    min_registered_seeds: int = 12


@dataclass(frozen=True)
class DenseConfig:
    """Depth maps and fusion."""

    backend: Literal["sgbm", "patchmatch"] = "sgbm"  # patchmatch needs CUDA
    neighbours: int = 3
    min_pair_angle_deg: float = 3.0
    max_pair_angle_deg: float = 35.0
    best_pair_angle_deg: float = 10.0
    # Smallest angle between a stereo pair's baseline and the line to the target. Of two cameras one behind the other
    # the rectified images are large and their depths poor.
    min_baseline_angle_deg: float = field(default=0.0, metadata=LATER)
    crop_half_width_m: float = 1.5
    # Where SGBM seeks depths: in all of the crop, or only where the sparse model has points.
    search: Literal["crop", "sparse"] = field(default="crop", metadata=LATER)
    agreeing_views: int = 3  # views, the reference included, that must agree on a depth
    consistency_views: int = 10
    consistency_relative_depth: float = 0.005
    consistency_px: float = 1.0
    fusion_voxel_m: float = (
        0.008  # points in one voxel are averaged; one pixel on the rock at 3.5 m is 7.5 mm
    )


@dataclass(frozen=True)
class EvaluationConfig:
    """Cleaning and metrics."""

    crop_half_extent_m: float = 1.5
    ground_ransac_iterations: int = 500
    ground_ransac_threshold_m: float = 0.03
    ground_max_tilt_deg: float = 15.0
    ground_max_offset_m: float = 0.2  # of the plane from z = 0 below the target
    sor_neighbours: int = 20
    sor_std_ratio: float = 2.0
    gt_gate_m: float = 0.0  # 0.05 in the authors' public code; 0 turns it off
    gt_samples: int = 100_000
    thresholds_mm: tuple[float, ...] = (16.0, 32.0, 48.0, 64.0, 80.0)
    azimuth_sectors: int = 12


def canonical(room: Any) -> dict[str, Any]:
    """A configuration, or a part of one, as a dictionary to form digests of: see `MissionConfig.digest`."""
    return _without_later(room, dataclasses.asdict(room))


def _without_later(room: Any, tree: dict[str, Any]) -> dict[str, Any]:
    """``tree``, the dictionary of ``room``, less the fields that came later and have their default."""
    kept = {}
    for f in dataclasses.fields(room):
        value = getattr(room, f.name)
        if dataclasses.is_dataclass(value):
            kept[f.name] = _without_later(value, tree[f.name])
        elif f.metadata != LATER or value != f.default:
            kept[f.name] = tree[f.name]
    return kept


@dataclass(frozen=True)
class MissionConfig:
    """Everything that decides a mission's outcome, together with the rock and the replicate."""

    preset: str = "paper"
    target_m: tuple[float, float, float] = (0.0, 0.0, 0.8)
    camera: CameraConfig = field(default_factory=CameraConfig)
    scene: SceneConfig = field(default_factory=SceneConfig)
    flight: FlightConfig = field(default_factory=FlightConfig)
    seed: SeedConfig = field(default_factory=SeedConfig)
    pool: PoolConfig = field(default_factory=PoolConfig)
    stop: StopConfig = field(default_factory=StopConfig)
    shared: SharedTermsConfig = field(default_factory=SharedTermsConfig)
    visibility: VisibilityConfig = field(default_factory=VisibilityConfig)
    covis: CovisConfig = field(default_factory=CovisConfig)
    b_aware: BAwareConfig = field(default_factory=BAwareConfig)
    gate: GateConfig = field(default_factory=GateConfig)
    sparse: SparseConfig = field(default_factory=SparseConfig)
    dense: DenseConfig = field(default_factory=DenseConfig)
    evaluation: EvaluationConfig = field(default_factory=EvaluationConfig)

    def __post_init__(self) -> None:
        validate(self)

    def to_dict(self) -> dict[str, Any]:
        """Plain nested dictionary (tuples become lists), ready for JSON or YAML."""
        return typing.cast(dict[str, Any], json.loads(json.dumps(dataclasses.asdict(self))))

    def digest(self) -> str:
        """First 16 hex digits of the SHA-256 of the canonical JSON form.

        A field that is `LATER` and has its default is left out: a mission flown before the field existed
        is the same mission.
        """
        text = json.dumps(_without_later(self, self.to_dict()), sort_keys=True, separators=(",", ":"))
        return hashlib.sha256(text.encode()).hexdigest()[:16]

    def with_values(self, values: dict[str, Any]) -> MissionConfig:
        """A copy with the named parameter paths replaced, e.g. ``{"covis.weights.nov": 0.3}``.

        Raises
        ------
        UserError
            A path does not exist, or a value has the wrong type or range.
        """
        tree = self.to_dict()
        for path, value in values.items():
            parts = path.split(".")
            node: Any = tree
            for part in parts[:-1]:
                if not isinstance(node, dict) or part not in node:
                    raise UserError(_unknown_path(path))
                node = node[part]
            if not isinstance(node, dict) or parts[-1] not in node or isinstance(node[parts[-1]], dict):
                raise UserError(_unknown_path(path))
            node[parts[-1]] = value
        return typing.cast(MissionConfig, _build(MissionConfig, tree, ""))


def _unknown_path(path: str) -> str:
    import difflib

    close = difflib.get_close_matches(path, parameter_paths(), n=3, cutoff=0.4)
    hint = f"; did you mean {', '.join(close)}?" if close else "; `gatetune config show` lists all paths"
    return f"unknown mission parameter {path!r}{hint}"


_type_hints = functools.cache(typing.get_type_hints)  # takes longer than everything else of a copy


def parameter_paths(cls: type = MissionConfig, prefix: str = "") -> list[str]:
    """All leaf parameter paths of ``MissionConfig`` in declaration order."""
    hints = _type_hints(cls)
    paths: list[str] = []
    for f in dataclasses.fields(cls):
        kind = hints[f.name]
        if dataclasses.is_dataclass(kind):
            paths += parameter_paths(typing.cast(type, kind), f"{prefix}{f.name}.")
        else:
            paths.append(f"{prefix}{f.name}")
    return paths


def config_from_dict(tree: dict[str, Any], base: MissionConfig | None = None) -> MissionConfig:
    """Build a configuration from a nested dictionary; missing keys come from ``base`` (default: paper).

    Raises
    ------
    UserError
        Unknown key, wrong type, or a value out of range.
    """
    merged = (base or MissionConfig()).to_dict()
    _merge(merged, tree, "")
    return typing.cast(MissionConfig, _build(MissionConfig, merged, ""))


def _merge(into: dict[str, Any], new: dict[str, Any], prefix: str) -> None:
    if not isinstance(new, dict):
        raise UserError(
            f"{prefix.rstrip('.') or 'configuration'} must be a mapping, not {type(new).__name__}"
        )
    for key, value in new.items():
        if key not in into:
            raise UserError(_unknown_path(f"{prefix}{key}"))
        if isinstance(into[key], dict):
            _merge(into[key], value, f"{prefix}{key}.")
        else:
            into[key] = value


def _build(cls: type, tree: dict[str, Any], prefix: str) -> Any:
    hints = _type_hints(cls)
    values = {}
    for f in dataclasses.fields(cls):
        kind, raw, path = hints[f.name], tree[f.name], f"{prefix}{f.name}"
        if dataclasses.is_dataclass(kind):
            values[f.name] = _build(typing.cast(type, kind), raw, f"{path}.")
        else:
            values[f.name] = _coerce(kind, raw, path)
    return cls(**values)


def _coerce(kind: Any, raw: Any, path: str) -> Any:
    origin = typing.get_origin(kind)
    if origin is Literal:
        allowed = typing.get_args(kind)
        if raw not in allowed:
            raise UserError(f"{path} is {raw!r}; allowed: {', '.join(map(str, allowed))}")
        return raw
    if origin is tuple:
        args = typing.get_args(kind)
        if not isinstance(raw, (list, tuple)):
            raise UserError(f"{path} must be a list, not {raw!r}")
        if len(args) == 2 and args[1] is Ellipsis:
            return tuple(_coerce(args[0], item, path) for item in raw)
        if len(raw) != len(args):
            raise UserError(f"{path} needs {len(args)} values, not {len(raw)}")
        return tuple(_coerce(a, item, path) for a, item in zip(args, raw))
    if kind is float and isinstance(raw, (int, float)) and not isinstance(raw, bool):
        if raw != raw or raw in (float("inf"), float("-inf")):
            raise UserError(f"{path} must be finite, not {raw!r}")
        return float(raw)
    if (
        kind is int
        and isinstance(raw, (int, float))
        and not isinstance(raw, bool)
        and float(raw).is_integer()
    ):
        return int(raw)
    if kind is bool and isinstance(raw, bool):
        return raw
    if kind is str and isinstance(raw, str):
        return raw
    name = getattr(kind, "__name__", str(kind)) if not isinstance(kind, types.UnionType) else str(kind)
    raise UserError(f"{path} must be of type {name}, not {raw!r}")


def validate(config: MissionConfig) -> None:
    """Raise ``UserError`` for the first value out of range."""

    def need(ok: bool, path: str, rule: str) -> None:
        if not ok:
            value: Any = config
            for part in path.split("."):
                value = getattr(value, part)
            raise UserError(f"{path} is {value!r}; it must be {rule}")

    need(
        config.camera.width_px >= 64 and config.camera.height_px >= 64,
        "camera.width_px",
        "at least 64 (height too)",
    )
    need(config.camera.focal_px > 0, "camera.focal_px", "positive")
    for path in ("seed.radius_m", "pool.radius_m", "shared.d_scale_m", "shared.d_travel_m",
                 "shared.theta_min_deg", "shared.box_half_extent_m", "flight.max_speed_m_s",
                 "flight.max_climb_m_s", "flight.max_acceleration_m_s2", "flight.max_jerk_m_s3",
                 "evaluation.crop_half_extent_m", "dense.crop_half_width_m",
                 "gate.oracle_threshold_m"):  # fmt: skip
        value: Any = config
        for part in path.split("."):
            value = getattr(value, part)
        need(value > 0, path, "positive")
    need(config.scene.sun_direction[2] < 0, "scene.sun_direction", "downward (negative third component)")
    need(0 <= config.scene.sky_grey <= 1, "scene.sky_grey", "between 0 and 1")
    for name in ("sun_irradiance", "ambient", "read_noise_dn", "shot_noise_dn"):
        need(getattr(config.scene, name) >= 0, f"scene.{name}", "0 or more")
    need(config.scene.sun_irradiance + config.scene.ambient > 0, "scene.ambient", "positive without a sun")
    need(config.flight.arrival_tolerance_m >= 0, "flight.arrival_tolerance_m", "0 or more")
    for name in ("max_yaw_rate_rad_s", "max_yaw_acceleration_rad_s2", "max_yaw_jerk_rad_s3"):
        need(getattr(config.flight, name) > 0, f"flight.{name}", "positive")
    for name in ("settle_s", "takeoff_altitude_m", "keep_out_radius_m", "keep_out_height_m",
                 "min_camera_altitude_m"):  # fmt: skip
        need(getattr(config.flight, name) >= 0, f"flight.{name}", "0 or more")
    need(len(config.seed.ring_elevations_deg) == len(config.seed.ring_azimuth_counts) > 0,
         "seed.ring_azimuth_counts", "as long as seed.ring_elevations_deg")  # fmt: skip
    need(sum(config.seed.ring_azimuth_counts) >= 3, "seed.ring_azimuth_counts", "at least 3 views in all")
    need(config.stop.adaptive_budget >= 1, "stop.adaptive_budget", "at least 1")
    need(config.stop.knn_neighbours >= 1, "stop.knn_neighbours", "at least 1")
    need(
        config.pool.min_altitude_m < config.pool.max_altitude_m,
        "pool.min_altitude_m",
        "below pool.max_altitude_m",
    )
    need(config.pool.lateral_count >= 0 and config.pool.upper_count >= 0, "pool.lateral_count",
         "0 or more (pool.upper_count too)")  # fmt: skip
    for path in ("seed.ring_elevations_deg", "pool.lateral_elevations_deg", "pool.upper_elevations_deg"):
        room, name = path.split(".")
        elevations: tuple[float, ...] = getattr(getattr(config, room), name)
        need(all(-90.0 < e < 90.0 for e in elevations), path, "elevations between -90 and 90 degrees")
    need(
        all(n >= 1 for n in config.seed.ring_azimuth_counts),
        "seed.ring_azimuth_counts",
        "at least 1 per ring",
    )
    need(config.pool.azimuth_sectors >= 1, "pool.azimuth_sectors", "at least 1")
    need(config.pool.max_candidates >= 1, "pool.max_candidates", "at least 1")
    for name in ("alpha_track", "alpha_density", "alpha_reprojection", "theta_low_deg"):
        need(getattr(config.b_aware, name) >= 0, f"b_aware.{name}", "0 or more")
    need(config.b_aware.density_neighbours >= 1, "b_aware.density_neighbours", "at least 1")
    need(config.gate.oracle_samples >= 100, "gate.oracle_samples", "at least 100")
    need(config.gate.oracle_matchable_views >= 2, "gate.oracle_matchable_views", "at least 2")
    need(0 <= config.gate.budget_fraction <= 1, "gate.budget_fraction", "between 0 and 1")
    need(config.gate.d95_m >= 0, "gate.d95_m", "0 or more")
    need(config.b_aware.theta_low_deg < config.b_aware.theta_saturation_deg,
         "b_aware.theta_low_deg", "below b_aware.theta_saturation_deg")  # fmt: skip
    need(config.b_aware.target_track_length >= 1, "b_aware.target_track_length", "at least 1")
    need(config.b_aware.matchable_views >= 2, "b_aware.matchable_views", "at least 2")
    need(config.shared.min_track_length >= 2, "shared.min_track_length", "at least 2")
    need(config.dense.agreeing_views >= 2, "dense.agreeing_views", "at least 2")
    need(config.dense.neighbours >= 1, "dense.neighbours", "at least 1")
    need(0 <= config.dense.min_baseline_angle_deg < 90, "dense.min_baseline_angle_deg", "in [0, 90)")
    need(config.sparse.max_features >= 1, "sparse.max_features", "at least 1")
    need(-1 <= config.sparse.first_octave <= 2, "sparse.first_octave", "-1 (twice the size) to 2")
    need(config.sparse.peak_threshold > 0, "sparse.peak_threshold", "above 0")
    need(0 < config.sparse.match_ratio <= 1, "sparse.match_ratio", "in (0, 1]")
    need(0 < config.sparse.max_pair_angle_deg <= 180, "sparse.max_pair_angle_deg", "in (0, 180]")
    need(config.sparse.max_pairs >= 0, "sparse.max_pairs", "0 (no limit) or more")
    need(config.sparse.min_inliers >= 8, "sparse.min_inliers", "at least 8")
    need(config.sparse.min_ransac_trials >= 1, "sparse.min_ransac_trials", "at least 1")
    need(config.sparse.global_ba_interval >= 1, "sparse.global_ba_interval", "at least 1")
    need(config.sparse.local_ba_images >= 2, "sparse.local_ba_images", "at least 2")
    need(config.sparse.local_ba_rounds >= 1, "sparse.local_ba_rounds", "at least 1")
    need(config.sparse.local_ba_iterations >= 0, "sparse.local_ba_iterations", "0 or more")
    need(config.sparse.global_ba_iterations >= 0, "sparse.global_ba_iterations", "0 or more")
    need(config.sparse.max_alignment_rms_m > 0, "sparse.max_alignment_rms_m", "above 0")
    need(config.sparse.min_registered_seeds >= 3, "sparse.min_registered_seeds", "at least 3")
    need(len(config.evaluation.thresholds_mm) > 0, "evaluation.thresholds_mm", "at least one threshold")
    need(config.evaluation.gt_samples >= 1000, "evaluation.gt_samples", "at least 1000")
    for scorer in ("covis", "b_aware"):
        w: Weights = getattr(config, scorer).weights
        for name in ("main", "nov", "move", "ang"):
            need(getattr(w, name) >= 0, f"{scorer}.weights.{name}", "0 or more")


# Ours, in both presets of the paper: work left out that the outcome does not show (docs/performance.md, "Less work for
# the same outcome"). Not defaults, so that the record of an earlier mission, which lacks these fields, means what it
# meant.
ECONOMIES: dict[str, Any] = {
    "sparse.max_pairs": 8,
    "sparse.min_ransac_trials": 30,  # nine matches of ten are right; where fewer are, COLMAP goes on by itself
    "sparse.global_ba_interval": 20,
    "sparse.local_ba_images": 3,
    "sparse.local_ba_rounds": 1,
    "sparse.local_ba_iterations": 2,
    "sparse.global_ba_iterations": 1,
    "sparse.update_pairs": "near",
    "dense.min_baseline_angle_deg": 40.0,
    "dense.search": "sparse",
}


def paper() -> MissionConfig:
    """The paper's text."""
    return MissionConfig().with_values(ECONOMIES)


def paper_code() -> MissionConfig:
    """What the authors' public code executes where it departs from the text."""
    return MissionConfig(preset="paper-code").with_values(
        {
            **ECONOMIES,
            "pool.min_altitude_m": 1.5,  # rejects the whole 10 degree ring
            "b_aware.alpha_track": 0.5,
            "b_aware.alpha_density": 0.3,
            "b_aware.alpha_reprojection": 0.2,
            "stop.criterion": "budget",
            "gate.oracle_coverage": "paper-code",
            "sparse.max_features": 16384,
            "sparse.max_pair_angle_deg": 180.0,  # exhaustive matching
            "sparse.max_pairs": 0,
            "evaluation.gt_gate_m": 0.05,
        }
    )


def campaign() -> MissionConfig:
    """Ours: the small budget and strict agreement at which configurations can be told apart.

    Chosen by ``gatetune study noise`` on training rocks (docs/results/noise_floor.md).
    """
    return MissionConfig(preset="campaign").with_values(
        {
            "stop.adaptive_budget": 8,
            "stop.criterion": "budget",
            "stop.knn_region": "box",  # far ground points would drown the rock in the statistic
            "sparse.first_octave": 0,
            "sparse.max_features": 4096,
            "sparse.max_pairs": 24,  # as in all that was measured with this preset
            "dense.agreeing_views": 6,
            "evaluation.gt_samples": 50_000,
        }
    )


PRESETS = {"paper": paper, "paper-code": paper_code, "campaign": campaign}


def preset(name: str) -> MissionConfig:
    """The preset called ``name``; ``UserError`` if there is none."""
    if name not in PRESETS:
        raise UserError(f"unknown preset {name!r}; there are {', '.join(PRESETS)}")
    return PRESETS[name]()
