"""The sections of a mission's configuration; each checks its own values."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import Literal

from nbv.config.registry import DENSE_BACKENDS, RENDERERS, SCORERS, gate_kinds
from nbv.config.sources import code, ours, text
from nbv.errors import UserError


class OutOfRange(UserError):
    """A value that its section does not allow; ``problem`` begins with the field's name."""

    def __init__(self, section: str, problem: str) -> None:
        super().__init__(section, problem)
        self.problem = problem

    def __str__(self) -> str:
        return ".".join(self.args)


class Section:
    """What the sections share: checks that name the field, its value and the rule."""

    def _need(self, ok: bool, name: str, rule: str) -> None:
        if not ok:
            raise OutOfRange(type(self).__name__, f"{name} is {getattr(self, name)!r}; it must be {rule}")

    def _need_positive(self, *names: str) -> None:
        for name in names:
            self._need(getattr(self, name) > 0, name, "positive")

    def _need_at_least(self, low: float, *names: str) -> None:
        rule = "0 or more" if low == 0 else f"at least {low:g}"
        for name in names:
            self._need(getattr(self, name) >= low, name, rule)

    def _need_known_names(self) -> None:
        """Fields that name a part of the program name one that there is."""
        for f in fields(self):  # type: ignore[arg-type]
            value = getattr(self, f.name)
            if "names" in f.metadata and value not in (allowed := f.metadata["names"]()):
                raise OutOfRange(type(self).__name__, f"{f.name} is {value!r}; allowed: {', '.join(allowed)}")

    def _need_elevations(self, *names: str) -> None:
        for name in names:
            inside = all(-90.0 < elevation < 90.0 for elevation in getattr(self, name))
            self._need(inside, name, "elevations between -90 and 90 degrees")


@dataclass(frozen=True)
class CameraConfig(Section):
    """Pinhole camera without distortion; pixel centres at half-integers, as in COLMAP."""

    width_px: int = code(640, "simulator", "image width")
    height_px: int = code(480, "simulator", "image height")
    focal_px: float = code(
        465.7412, "simulator, 1.204 rad of view", "focal length, known and shared by all photographs"
    )

    def __post_init__(self) -> None:
        self._need_at_least(16, "width_px", "height_px")
        self._need_positive("focal_px")


@dataclass(frozen=True)
class SceneConfig(Section):
    """Light, ground and sensor."""

    backend: str = ours("raycast", "renderer", why="gl needs a display or EGL", names=RENDERERS.keys)
    sun_direction: tuple[float, float, float] = code(
        (0.001, 0.625, -0.78), "simulator", "direction the light travels, ENU"
    )
    sun_irradiance: float = code(0.904, "simulator", "brightness of the sun, relative")
    ambient: float = code(0.4, "simulator", "brightness of the sky, relative")
    sky_grey: float = code(0.7, "simulator", "grey of the background, 0 to 1")
    ground_seed: int = ours(0, "which procedural ground")
    read_noise_dn: float = ours(
        1.0, "Gaussian noise of the sensor, 8-bit digital numbers", why="the simulator has none"
    )
    shot_noise_dn: float = ours(
        1.5,
        "standard deviation at full scale; grows with the square root of the signal",
        why="the simulator has none",
    )

    def __post_init__(self) -> None:
        self._need(self.sun_direction[2] < 0, "sun_direction", "downward (negative third component)")
        self._need(0 <= self.sky_grey <= 1, "sky_grey", "between 0 and 1")
        self._need_at_least(0, "sun_irradiance", "ambient", "read_noise_dn", "shot_noise_dn")
        self._need(self.sun_irradiance + self.ambient > 0, "ambient", "positive without a sun")


@dataclass(frozen=True)
class FlightConfig(Section):
    """X500-class multirotor limits and the paper's arrival test."""

    home_m: tuple[float, float, float] = ours(
        (0.0, -8.0, 0.0), "take-off point, ENU", why="8 m away as in the public code, from the south"
    )
    takeoff_altitude_m: float = code(3.0, "mission file", "altitude after take-off")
    max_speed_m_s: float = ours(5.0, "top speed", why="X500 class")
    max_climb_m_s: float = ours(2.0, "top climb rate", why="X500 class")
    max_acceleration_m_s2: float = ours(3.0, "acceleration limit", why="X500 class")
    max_jerk_m_s3: float = ours(8.0, "jerk limit", why="X500 class")
    max_yaw_rate_rad_s: float = ours(0.8, "yaw rate limit", why="X500 class")
    max_yaw_acceleration_rad_s2: float = ours(1.5, "yaw acceleration limit", why="X500 class")
    max_yaw_jerk_rad_s3: float = ours(6.0, "yaw jerk limit", why="X500 class")
    arrival_tolerance_m: float = code(0.35, "arrival test", "largest error of arrival, per axis")
    settle_s: float = code(2.0, "mission file", "pause before a photograph")
    keep_out_radius_m: float = ours(
        1.3,
        "upright cylinder around the target that straight legs go round",
        why="the public code flies through",
    )
    keep_out_height_m: float = ours(2.2, "its top, above the ground", why="the public code flies through")
    min_camera_altitude_m: float = ours(0.3, "arrival errors never take the camera below")

    def __post_init__(self) -> None:
        self._need_positive("max_speed_m_s", "max_climb_m_s", "max_acceleration_m_s2", "max_jerk_m_s3")
        self._need_positive("max_yaw_rate_rad_s", "max_yaw_acceleration_rad_s2", "max_yaw_jerk_rad_s3")
        self._need_at_least(0, "takeoff_altitude_m", "arrival_tolerance_m", "settle_s")
        self._need_at_least(0, "keep_out_radius_m", "keep_out_height_m", "min_camera_altitude_m")


@dataclass(frozen=True)
class SeedConfig(Section):
    """Phase 1: stratified ring orbit."""

    radius_m: float = text(4.0, "III, Phase 1", "distance of the seed orbit to the target")
    ring_elevations_deg: tuple[float, ...] = text(
        (15.0, 22.0, 29.0, 36.0), "III, Phase 1", "elevations of the seed rings"
    )
    ring_azimuth_counts: tuple[int, ...] = text((8, 6, 6, 4), "III, Phase 1", "views in each seed ring")

    def __post_init__(self) -> None:
        self._need_positive("radius_m")
        self._need_elevations("ring_elevations_deg")
        self._need(
            len(self.ring_elevations_deg) == len(self.ring_azimuth_counts) > 0,
            "ring_azimuth_counts",
            "as long as ring_elevations_deg",
        )
        self._need(
            all(n >= 1 for n in self.ring_azimuth_counts), "ring_azimuth_counts", "at least 1 per ring"
        )
        self._need(sum(self.ring_azimuth_counts) >= 3, "ring_azimuth_counts", "at least 3 views in all")


@dataclass(frozen=True)
class PoolConfig(Section):
    """Phase 2: two-band candidate pool and its feasibility filters."""

    radius_m: float = text(3.5, "III, Phase 2", "distance of the candidates to the target")
    lateral_elevations_deg: tuple[float, ...] = text(
        (10.0, 15.0, 25.0, 35.0), "III, Phase 2", "elevations of the dense lower band"
    )
    lateral_count: int = code(120, "mission file", "candidates in it, by inverse rank over its rings")
    upper_elevations_deg: tuple[float, ...] = text(
        (35.0, 45.0, 55.0), "III, Phase 2", "elevations of the sparse upper band"
    )
    upper_count: int = code(50, "mission file", "candidates in it, evenly over its rings")
    min_altitude_m: float = ours(
        1.3, "lowest candidate", why="the code's 1.5 drops the 10° ring, which the text has"
    )
    max_altitude_m: float = code(20.0, "mission file", "highest candidate", label="altitude limit")
    max_travel_m: float = code(40.0, "mission file", "farthest candidate from the vehicle")
    min_spacing_m: float = code(0.3, "candidate filter", "least distance between candidates")
    revisit_exclusion_m: float = code(0.6, "mission file", "least distance to an adaptive capture")
    azimuth_sectors: int = code(8, "mission file", "sectors by whose captures candidates are ordered")
    max_candidates: int = code(200, "mission file", "candidates that are scored, at most")

    def __post_init__(self) -> None:
        self._need_positive("radius_m")
        self._need_elevations("lateral_elevations_deg", "upper_elevations_deg")
        self._need_at_least(0, "lateral_count", "upper_count")
        self._need(self.min_altitude_m < self.max_altitude_m, "min_altitude_m", "below max_altitude_m")
        self._need_at_least(1, "azimuth_sectors", "max_candidates")


@dataclass(frozen=True)
class StopConfig(Section):
    """Phase 2 ends when the budget is used or the sparse cloud has converged."""

    adaptive_budget: int = code(40, "mission file", "captures after the seeds, registered or not")
    criterion: Literal["both", "budget", "knn"] = text(
        "both", "III, Phase 2", "what ends Phase 2; both: whichever comes first"
    )
    knn_threshold_m: float = code(0.003, "mission file", "d95 below which the sparse cloud has converged")
    knn_neighbours: int = code(5, "COLMAP settings", "d95 is of the distance to this neighbour")
    knn_region: Literal["all", "box"] = text(
        "all", "III-B, the sparse cloud", "points that d95 is of: all, or those in the box"
    )

    def __post_init__(self) -> None:
        self._need_at_least(1, "adaptive_budget", "knn_neighbours")


@dataclass(frozen=True)
class Weights(Section):
    """Weights of Eq. 1; only their ratios matter to the ranking."""

    main: float = text(1.0, "Eq. 1", "weight of the main term", label="weight W_main", symbol="W_main")
    nov: float = text(1.2, "Eq. 1", "weight of novelty", label="weight W_nov", symbol="W_nov")
    move: float = text(0.1, "Eq. 1", "weight of the movement cost", label="weight W_move", symbol="W_move")
    ang: float = text(0.4, "Eq. 1", "weight of the angular penalty", label="weight W_ang", symbol="W_ang")

    def __post_init__(self) -> None:
        self._need_at_least(0, "main", "nov", "move", "ang")


@dataclass(frozen=True)
class SharedTermsConfig(Section):
    """Scales of Eq. 2 to 4 and the point set of Eq. 5 and 8."""

    d_scale_m: float = text(
        2.0, "Eq. 2", "distance at which novelty saturates", label="novelty scale d_scale", symbol="d_scale"
    )
    d_travel_m: float = text(
        10.0, "Eq. 3", "scale of the movement cost", label="travel scale d_travel", symbol="d_travel"
    )
    theta_min_deg: float = text(
        20.0,
        "Eq. 4",
        "angle to a visited direction below which it is penalised",
        label="angular penalty θ_min",
        symbol="θ_min",
    )
    box_half_extent_m: float = text(
        2.0, "III-A", "half the side of the box around the target whose points count"
    )
    min_track_length: int = code(2, "scorers", "photographs that must see a point for it to count")

    def __post_init__(self) -> None:
        self._need_positive("d_scale_m", "d_travel_m", "theta_min_deg", "box_half_extent_m")
        self._need_at_least(2, "min_track_length")


@dataclass(frozen=True)
class VisibilityConfig(Section):
    """Which points count as visible: all in the image, or also facing the candidate and not hidden."""

    mode: Literal["frustum", "occlusion"] = text(
        "frustum",
        "III-A",
        "which points a candidate sees: all in its image, or only those not hidden",
        label="model",
        symbol="visibility",
    )


@dataclass(frozen=True)
class CovisConfig(Section):
    weights: Weights = field(default_factory=Weights)


@dataclass(frozen=True)
class BAwareConfig(Section):
    """Eq. 6 and 7."""

    weights: Weights = field(default_factory=Weights)
    alpha_track: float = text(
        0.6, "Eq. 6", "weight of short tracks", label="α_τ (track support)", symbol="α_τ"
    )
    alpha_density: float = text(0.4, "Eq. 6", "weight of low density", label="α_ρ (density)", symbol="α_ρ")
    alpha_reprojection: float = text(
        0.0,
        "Eq. 6 has no such term",
        "weight of the reprojection error",
        label="α_e (reprojection)",
        symbol="α_e",
    )
    target_track_length: int = text(
        6, "Eq. 6", "track length at which a point is strong", label="target track length T*", symbol="T*"
    )
    density_neighbours: int = text(5, "Eq. 6", "neighbours whose mean distance is the density")
    theta_low_deg: float = text(
        5.0,
        "Eq. 7",
        "angle to a ray below which another is redundant",
        label="redundancy floor θ_l",
        symbol="θ_l",
    )
    theta_saturation_deg: float = text(
        25.0,
        "Eq. 7",
        "angle to all rays beyond which nothing is gained",
        label="saturation angle θ*",
        symbol="θ*",
    )

    def __post_init__(self) -> None:
        self._need_at_least(0, "alpha_track", "alpha_density", "alpha_reprojection", "theta_low_deg")
        self._need_at_least(1, "target_track_length", "density_neighbours")
        self._need(
            self.theta_low_deg < self.theta_saturation_deg, "theta_low_deg", "below theta_saturation_deg"
        )


@dataclass(frozen=True)
class MatchableConfig(Section):
    """Ours: which surface still lacks views that dense stereo could match (`nbv.scorers.matchable`)."""

    weights: Weights = field(default_factory=Weights)
    views: int = ours(6, "views that must match one another on a piece of surface")

    def __post_init__(self) -> None:
        self._need_at_least(2, "views")


@dataclass(frozen=True)
class GateConfig(Section):
    """Which ranking is flown (Eq. 9 for ``hyb-h``)."""

    kind: str = text(
        "hyb-h", "III-B", "which ranking is flown; a scorer's name: that scorer alone", names=gate_kinds
    )
    geometry_scorer: str = text(
        "b-aware", "III-B", "scorer that Hyb-H and Hyb-O switch to from Covis", names=SCORERS.keys, added=True
    )
    budget_fraction: float = text(
        0.4,
        "Eq. 9",
        "budget fraction below which Hyb-H flies the geometry scorer",
        label="budget fraction f_b",
        symbol="f_b",
    )
    d95_m: float = text(
        0.14,
        "Eq. 9",
        "d95 above which Hyb-H flies the geometry scorer",
        label="KNN distance d95",
        symbol="d95",
    )
    oracle_coverage: Literal["reconstruction", "seen", "matchable", "paper-code"] = ours(
        "reconstruction", "when Hyb-O counts a sample as covered", why="how we read III-B"
    )
    oracle_samples: int = text(30_000, "III-B", "samples of the true surface that Hyb-O counts")
    oracle_threshold_m: float = text(0.02, "III-B", "distance at which a sample is covered")
    oracle_matchable_views: int = ours(3, "views that must see a sample where coverage is matchable")
    learned_policy: str = ours("", "path of a policy for the learned gate; empty: the one that ships")

    def __post_init__(self) -> None:
        self._need_known_names()
        self._need(0 <= self.budget_fraction <= 1, "budget_fraction", "between 0 and 1")
        self._need_at_least(0, "d95_m")
        self._need_at_least(100, "oracle_samples")
        self._need_positive("oracle_threshold_m")
        self._need_at_least(2, "oracle_matchable_views")


@dataclass(frozen=True)
class SparseConfig(Section):
    """Features, matching, incremental mapping, alignment."""

    max_features: int = ours(
        8192, "features of a photograph, at most", why="COLMAP's default; the authors' 16384"
    )
    first_octave: int = code(-1, "COLMAP's default", "-1: features of the doubled image too")
    peak_threshold: float = code(0.0066, "COLMAP's default", "least contrast of a feature")
    match_ratio: float = code(0.8, "COLMAP's default", "best distance over second best, at most")
    max_pair_angle_deg: float = code(180.0, "exhaustive", "views that look farther apart are not matched")
    max_pairs: int = code(
        0, "exhaustive", "earlier photographs to match a new one with, nearest directions first; 0: all"
    )
    min_inliers: int = code(15, "COLMAP's default", "matches of a verified pair, at least")
    min_ransac_trials: int = code(
        100, "COLMAP's default", "trials of two-view verification, at least", added=True
    )
    global_ba_interval: int = ours(5, "captures between global bundle adjustments")
    local_ba_images: int = code(6, "COLMAP's default", "photographs in a local adjustment", added=True)
    local_ba_rounds: int = code(
        2, "COLMAP's default", "times a local adjustment is repeated, at most", added=True
    )
    local_ba_iterations: int = code(
        0, "COLMAP's default", "solver steps of a local adjustment; 0: COLMAP's limit", added=True
    )
    global_ba_iterations: int = code(
        0, "COLMAP's default", "solver steps of a global adjustment; 0: COLMAP's limit", added=True
    )
    update_pairs: Literal["all", "near"] = code(
        "all", "COLMAP's default", "pairs that an update between global adjustments sees", added=True
    )
    max_alignment_rms_m: float = ours(0.10, "residual to telemetry beyond which the model is wrong")
    min_registered_seeds: int = ours(12, "seeds that must register for the mission to go on")

    def __post_init__(self) -> None:
        self._need_at_least(1, "max_features", "min_ransac_trials", "global_ba_interval", "local_ba_rounds")
        self._need(-1 <= self.first_octave <= 2, "first_octave", "-1 (twice the size) to 2")
        self._need_positive("peak_threshold", "max_alignment_rms_m")
        self._need(0 < self.match_ratio <= 1, "match_ratio", "in (0, 1]")
        self._need(0 < self.max_pair_angle_deg <= 180, "max_pair_angle_deg", "in (0, 180]")
        self._need(self.max_pairs >= 0, "max_pairs", "0 (no limit) or more")
        self._need_at_least(8, "min_inliers")
        self._need_at_least(2, "local_ba_images")
        self._need_at_least(0, "local_ba_iterations", "global_ba_iterations")
        self._need_at_least(3, "min_registered_seeds")


@dataclass(frozen=True)
class DenseConfig(Section):
    """Depth maps and fusion."""

    backend: str = ours(
        "sgbm",
        "stereo",
        why="the paper's COLMAP PatchMatch needs CUDA: patchmatch",
        names=DENSE_BACKENDS.keys,
    )
    neighbours: int = ours(3, "stereo partners of a photograph")
    min_pair_angle_deg: float = ours(3.0, "least angle of a stereo pair, seen from the target")
    max_pair_angle_deg: float = ours(35.0, "largest angle of a stereo pair")
    best_pair_angle_deg: float = ours(10.0, "best angle of a stereo pair")
    min_baseline_angle_deg: float = ours(
        0.0, "least angle between a pair's baseline and the line to the target", added=True
    )
    crop_half_width_m: float = ours(1.5, "half the side of the cube in which depths are sought")
    search: Literal["crop", "sparse"] = ours(
        "crop", "depths are sought in all of the cube, or near the sparse model", added=True
    )
    agreeing_views: int = ours(3, "views, the reference included, that must agree on a depth")
    consistency_views: int = ours(10, "views that are asked")
    consistency_relative_depth: float = ours(0.005, "difference at which depths agree, relative")
    consistency_px: float = ours(1.0, "error of reprojection at which depths agree")
    fusion_voxel_m: float = ours(0.008, "points in one voxel are averaged", why="a pixel at 3.5 m is 7.5 mm")

    def __post_init__(self) -> None:
        self._need_at_least(1, "neighbours")
        self._need(0 <= self.min_baseline_angle_deg < 90, "min_baseline_angle_deg", "in [0, 90)")
        self._need_positive("crop_half_width_m")
        self._need_at_least(2, "agreeing_views")


@dataclass(frozen=True)
class EvaluationConfig(Section):
    """Cleaning and metrics."""

    crop_half_extent_m: float = code(1.5, "evaluation script", "half the side of the cube that is kept")
    ground_ransac_iterations: int = code(500, "evaluation script", "trials of the ground plane")
    ground_ransac_threshold_m: float = code(
        0.03, "evaluation script", "distance to the ground plane that is ground"
    )
    ground_max_tilt_deg: float = ours(
        15.0, "largest tilt of the ground plane", why="else a facet of the rock may go"
    )
    ground_max_offset_m: float = ours(0.2, "largest distance of the ground plane from z = 0 below the target")
    sor_neighbours: int = code(20, "evaluation script", "neighbours in statistical outlier removal")
    sor_std_ratio: float = code(
        2.0, "evaluation script", "standard deviations beyond which a point is an outlier"
    )
    gt_gate_m: float = text(0.0, "IV has no gate", "points farther from the truth are deleted; 0: none")
    gt_samples: int = code(100_000, "evaluation script", "samples of the true surface for the metrics")
    thresholds_mm: tuple[float, ...] = code(
        (16.0, 32.0, 48.0, 64.0, 80.0),
        "evaluation script; IV prints two",
        "thresholds of completeness, accuracy and F-score",
    )
    azimuth_sectors: int = code(12, "comparison script", "sectors of completeness by azimuth")

    def __post_init__(self) -> None:
        self._need_positive("crop_half_extent_m")
        self._need_at_least(1000, "gt_samples")
        self._need(len(self.thresholds_mm) > 0, "thresholds_mm", "at least one threshold")
