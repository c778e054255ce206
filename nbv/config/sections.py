"""The sections of a mission's configuration; each checks its own values."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from nbv.errors import UserError

GATE_KINDS = (
    "covis", "b-aware", "hyb-h", "hyb-o", "greedy-oracle", "learned",
    "random", "novelty-only", "movement-only", "uniform-coverage",
)  # fmt: skip
GateKind = Literal[
    "covis", "b-aware", "hyb-h", "hyb-o", "greedy-oracle", "learned",
    "random", "novelty-only", "movement-only", "uniform-coverage",
]  # fmt: skip
# Mark of a field that came after missions had been recorded; see `canonical`.
ADDED_SINCE_VERSION_1 = {"added_since_version_1": True}


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

    def _need_elevations(self, *names: str) -> None:
        for name in names:
            inside = all(-90.0 < elevation < 90.0 for elevation in getattr(self, name))
            self._need(inside, name, "elevations between -90 and 90 degrees")


@dataclass(frozen=True)
class CameraConfig(Section):
    """Pinhole camera without distortion; pixel centres at half-integers, as in COLMAP."""

    width_px: int = 640
    height_px: int = 480
    focal_px: float = 465.7412  # hfov 1.204 rad at 640 px, the paper's simulated camera

    def __post_init__(self) -> None:
        self._need_at_least(16, "width_px", "height_px")
        self._need_positive("focal_px")


@dataclass(frozen=True)
class SceneConfig(Section):
    """Light, ground and sensor."""

    backend: Literal["raycast", "gl"] = "raycast"
    sun_direction: tuple[float, float, float] = (0.001, 0.625, -0.78)  # direction the light travels, ENU
    sun_irradiance: float = 0.904
    ambient: float = 0.4
    sky_grey: float = 0.7
    ground_seed: int = 0
    read_noise_dn: float = 1.0  # Gaussian, 8-bit digital numbers
    shot_noise_dn: float = 1.5  # standard deviation at full scale; grows with the square root of the signal

    def __post_init__(self) -> None:
        self._need(self.sun_direction[2] < 0, "sun_direction", "downward (negative third component)")
        self._need(0 <= self.sky_grey <= 1, "sky_grey", "between 0 and 1")
        self._need_at_least(0, "sun_irradiance", "ambient", "read_noise_dn", "shot_noise_dn")
        self._need(self.sun_irradiance + self.ambient > 0, "ambient", "positive without a sun")


@dataclass(frozen=True)
class FlightConfig(Section):
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

    def __post_init__(self) -> None:
        self._need_positive("max_speed_m_s", "max_climb_m_s", "max_acceleration_m_s2", "max_jerk_m_s3")
        self._need_positive("max_yaw_rate_rad_s", "max_yaw_acceleration_rad_s2", "max_yaw_jerk_rad_s3")
        self._need_at_least(0, "takeoff_altitude_m", "arrival_tolerance_m", "settle_s")
        self._need_at_least(0, "keep_out_radius_m", "keep_out_height_m", "min_camera_altitude_m")


@dataclass(frozen=True)
class SeedConfig(Section):
    """Phase 1: stratified ring orbit."""

    radius_m: float = 4.0
    ring_elevations_deg: tuple[float, ...] = (15.0, 22.0, 29.0, 36.0)
    ring_azimuth_counts: tuple[int, ...] = (8, 6, 6, 4)

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

    def __post_init__(self) -> None:
        self._need_positive("radius_m")
        self._need_elevations("lateral_elevations_deg", "upper_elevations_deg")
        self._need_at_least(0, "lateral_count", "upper_count")
        self._need(self.min_altitude_m < self.max_altitude_m, "min_altitude_m", "below max_altitude_m")
        self._need_at_least(1, "azimuth_sectors", "max_candidates")


@dataclass(frozen=True)
class StopConfig(Section):
    """Phase 2 ends when the budget is used or the sparse cloud has converged."""

    adaptive_budget: int = 40  # captures after the seeds; an image that does not register counts too
    criterion: Literal["both", "budget", "knn"] = "both"  # both = whichever comes first
    knn_threshold_m: float = 0.003
    knn_neighbours: int = 5  # distance to the 5th neighbour
    knn_region: Literal["all", "box"] = "all"

    def __post_init__(self) -> None:
        self._need_at_least(1, "adaptive_budget", "knn_neighbours")


@dataclass(frozen=True)
class Weights(Section):
    """Weights of Eq. 1; only their ratios matter to the ranking."""

    main: float = 1.0
    nov: float = 1.2
    move: float = 0.1
    ang: float = 0.4

    def __post_init__(self) -> None:
        self._need_at_least(0, "main", "nov", "move", "ang")


@dataclass(frozen=True)
class SharedTermsConfig(Section):
    """Scales of Eq. 2 to 4 and the point set of Eq. 5 and 8."""

    d_scale_m: float = 2.0
    d_travel_m: float = 10.0
    theta_min_deg: float = 20.0
    box_half_extent_m: float = 2.0
    min_track_length: int = 2

    def __post_init__(self) -> None:
        self._need_positive("d_scale_m", "d_travel_m", "theta_min_deg", "box_half_extent_m")
        self._need_at_least(2, "min_track_length")


@dataclass(frozen=True)
class VisibilityConfig(Section):
    """Which points count as visible: all in the image, or also facing the candidate and not hidden."""

    mode: Literal["frustum", "occlusion"] = "frustum"


@dataclass(frozen=True)
class CovisConfig(Section):
    weights: Weights = field(default_factory=Weights)


@dataclass(frozen=True)
class BAwareConfig(Section):
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
    main_term: Literal["repair", "matchable"] = field(default="repair", metadata=ADDED_SINCE_VERSION_1)
    matchable_views: int = field(
        default=6, metadata=ADDED_SINCE_VERSION_1
    )  # that must match one another on a piece of surface

    def __post_init__(self) -> None:
        self._need_at_least(0, "alpha_track", "alpha_density", "alpha_reprojection", "theta_low_deg")
        self._need_at_least(1, "target_track_length", "density_neighbours")
        self._need(
            self.theta_low_deg < self.theta_saturation_deg, "theta_low_deg", "below theta_saturation_deg"
        )
        self._need_at_least(2, "matchable_views")


@dataclass(frozen=True)
class GateConfig(Section):
    """Which ranking is flown (Eq. 9 for ``hyb-h``)."""

    kind: GateKind = "hyb-h"
    budget_fraction: float = 0.4
    d95_m: float = 0.14
    oracle_coverage: Literal["reconstruction", "seen", "matchable", "paper-code"] = "reconstruction"
    oracle_samples: int = 30_000
    oracle_threshold_m: float = 0.02
    oracle_matchable_views: int = 3  # views that must see a sample, for oracle_coverage="matchable"
    learned_policy: str = ""  # path of a policy JSON, for kind="learned"; empty: the shipped policy

    def __post_init__(self) -> None:
        self._need(0 <= self.budget_fraction <= 1, "budget_fraction", "between 0 and 1")
        self._need_at_least(0, "d95_m")
        self._need_at_least(100, "oracle_samples")
        self._need_positive("oracle_threshold_m")
        self._need_at_least(2, "oracle_matchable_views")


@dataclass(frozen=True)
class SparseConfig(Section):
    """Features, matching, incremental mapping, alignment."""

    max_features: int = 8192
    first_octave: int = -1
    peak_threshold: float = 0.0066  # COLMAP's default, 0.02 / 3
    match_ratio: float = 0.8
    max_pair_angle_deg: float = 130.0  # pairs whose viewing directions differ more are not matched
    # Earlier photographs to match a new one with, nearest directions first; 0 = all. Ours: the paper matches all, with
    # the same outcome along the same views (docs/results/reduced_sfm.md).
    max_pairs: int = 12
    min_inliers: int = 15
    min_ransac_trials: int = field(
        default=100, metadata=ADDED_SINCE_VERSION_1
    )  # of two-view verification; COLMAP's default
    global_ba_interval: int = 5  # captures between global bundle adjustments
    # Photographs in a local adjustment, the new one included, and how often at most it is repeated; COLMAP's defaults.
    local_ba_images: int = field(default=6, metadata=ADDED_SINCE_VERSION_1)
    local_ba_rounds: int = field(default=2, metadata=ADDED_SINCE_VERSION_1)
    # Solver iterations of one adjustment after the seed model, at most; 0: COLMAP's limits, 25 and 50.
    local_ba_iterations: int = field(default=0, metadata=ADDED_SINCE_VERSION_1)
    global_ba_iterations: int = field(default=0, metadata=ADDED_SINCE_VERSION_1)
    # Pairs whose matches an update between global adjustments sees: all, or those of the new photograph's partners.
    update_pairs: Literal["all", "near"] = field(default="all", metadata=ADDED_SINCE_VERSION_1)
    max_alignment_rms_m: float = 0.10  # beyond this the model is wrong, not noisy
    min_registered_seeds: int = 12

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

    backend: Literal["sgbm", "patchmatch"] = "sgbm"  # patchmatch needs CUDA
    neighbours: int = 3
    min_pair_angle_deg: float = 3.0
    max_pair_angle_deg: float = 35.0
    best_pair_angle_deg: float = 10.0
    # Smallest angle between a stereo pair's baseline and the line to the target. Of two cameras one behind the other
    # the rectified images are large and their depths poor.
    min_baseline_angle_deg: float = field(default=0.0, metadata=ADDED_SINCE_VERSION_1)
    crop_half_width_m: float = 1.5
    # Where SGBM seeks depths: in all of the crop, or only where the sparse model has points.
    search: Literal["crop", "sparse"] = field(default="crop", metadata=ADDED_SINCE_VERSION_1)
    agreeing_views: int = 3  # views, the reference included, that must agree on a depth
    consistency_views: int = 10
    consistency_relative_depth: float = 0.005
    consistency_px: float = 1.0
    fusion_voxel_m: float = (
        0.008  # points in one voxel are averaged; one pixel on the rock at 3.5 m is 7.5 mm
    )

    def __post_init__(self) -> None:
        self._need_at_least(1, "neighbours")
        self._need(0 <= self.min_baseline_angle_deg < 90, "min_baseline_angle_deg", "in [0, 90)")
        self._need_positive("crop_half_width_m")
        self._need_at_least(2, "agreeing_views")


@dataclass(frozen=True)
class EvaluationConfig(Section):
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

    def __post_init__(self) -> None:
        self._need_positive("crop_half_extent_m")
        self._need_at_least(1000, "gt_samples")
        self._need(len(self.thresholds_mm) > 0, "thresholds_mm", "at least one threshold")
