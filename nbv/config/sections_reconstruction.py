"""The sections for what is made of the photographs: sparse model, dense cloud and metrics."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from msgspec import Meta

from nbv.config.declaration import (
    Count,
    NonNegative,
    OneOrMore,
    Positive,
    Section,
    TwoOrMore,
    code,
    not_in_paper,
    text,
)
from nbv.config.names import DENSE_BACKENDS

_PairAngle = Annotated[float, Meta(ge=0, le=180)]


@dataclass(frozen=True)
class SparseConfig(Section):
    """Features, matching, incremental mapping, alignment."""

    max_features: OneOrMore = not_in_paper(
        8192, "most features of a photograph", reason="COLMAP's default; the authors' 16384"
    )
    ground_features: Count = not_in_paper(
        0,
        "most features of the ground, found in the photograph rectified to a view from above by telemetry; 0: none",
        reason="hold views 30° and more apart together, which SIFT matches too rarely",
    )
    first_octave: Annotated[int, Meta(ge=-1, le=2)] = code(
        -1, "COLMAP's default", "first octave of SIFT; -1: the doubled image"
    )
    peak_threshold: Positive = code(0.0066, "COLMAP's default", "least contrast of a feature")
    match_ratio: Annotated[float, Meta(gt=0, le=1)] = code(
        0.8, "COLMAP's default", "largest ratio of best to second-best distance"
    )
    max_pair_angle_deg: Annotated[float, Meta(gt=0, le=180)] = code(
        180.0, "exhaustive", "largest angle between viewing directions of a matched pair"
    )
    max_pairs: Count = code(
        0, "exhaustive", "photographs that a new one is matched with, nearest directions first; 0: all"
    )
    min_inliers: Annotated[int, Meta(ge=8)] = code(15, "COLMAP's default", "least matches of a verified pair")
    min_ransac_trials: OneOrMore = code(100, "COLMAP's default", "least trials of two-view verification")
    global_ba_interval: OneOrMore = not_in_paper(5, "captures between global bundle adjustments")
    local_ba_images: TwoOrMore = code(6, "COLMAP's default", "photographs in a local adjustment")
    local_ba_rounds: OneOrMore = code(2, "COLMAP's default", "most rounds of a local adjustment")
    local_ba_iterations: Count = code(
        0, "COLMAP's default", "solver steps of a local adjustment; 0: COLMAP's limit"
    )
    global_ba_iterations: Count = code(
        0, "COLMAP's default", "solver steps of a global adjustment; 0: COLMAP's limit"
    )
    update_pairs: Literal["all", "near"] = code(
        "all", "COLMAP's default", "pairs that an update between global adjustments uses"
    )
    max_alignment_rms_m: Positive = not_in_paper(
        0.10, "rms residual to telemetry above which the mission fails (`wrong_model`)"
    )
    min_registered_seeds: Annotated[int, Meta(ge=3)] = not_in_paper(
        12, "seeds that must register for the mission to go on"
    )


_TABLE = "docs/results/index.md has the table"


@dataclass(frozen=True)
class DenseConfig(Section):
    """Depth maps and fusion."""

    backend: str = not_in_paper(
        "sgbm",
        "dense stereo",
        reason="the paper's COLMAP PatchMatch needs CUDA: patchmatch",
        names=lambda: DENSE_BACKENDS,
        plugins=True,
    )
    neighbours: Annotated[int, Meta(ge=1, le=127)] = not_in_paper(3, "stereo partners of a photograph")
    min_pair_angle_deg: _PairAngle = not_in_paper(3.0, "least angle of a stereo pair, seen from the target")
    max_pair_angle_deg: _PairAngle = not_in_paper(35.0, "largest angle of a stereo pair")
    best_pair_angle_deg: Annotated[float, Meta(gt=0, le=180)] = not_in_paper(
        10.0, "best angle of a stereo pair"
    )
    min_baseline_angle_deg: Annotated[float, Meta(ge=0, lt=90)] = not_in_paper(
        0.0, "least angle between a pair's baseline and the line to the target"
    )
    crop_half_width_m: Positive = not_in_paper(1.5, "half the side of the cube in which depths are sought")
    search: Literal["crop", "sparse"] = not_in_paper(
        "crop", "whether depths are sought in the whole cube or near the sparse model"
    )
    max_size_px: int = not_in_paper(0, "long side to which photographs are reduced for stereo; 0: as taken")
    agreeing_views: TwoOrMore = not_in_paper(3, "views, the reference included, that must agree on a depth")
    consistency_views: Annotated[int, Meta(ge=1, le=254)] = not_in_paper(
        10, "views in which a depth is checked"
    )
    consistency_relative_depth: Positive = not_in_paper(
        0.005, "largest relative difference of agreeing depths"
    )
    consistency_px: Positive = not_in_paper(1.0, "largest reprojection error of agreeing depths")
    patchmatch_sources: OneOrMore = not_in_paper(
        6, "photographs that PatchMatch matches one with", reason=_TABLE
    )
    patchmatch_iterations: OneOrMore = not_in_paper(3, "sweeps of PatchMatch", reason=_TABLE)
    patchmatch_window_radius_px: Annotated[int, Meta(ge=1, le=32)] = code(
        5, "COLMAP's default", "half the side of PatchMatch's window"
    )
    patchmatch_window_step_px: Annotated[int, Meta(ge=1, le=2)] = not_in_paper(
        2, "distance of the pixels that PatchMatch compares in its window", reason=_TABLE
    )
    patchmatch_draws: OneOrMore = not_in_paper(
        8, "times that PatchMatch draws a source for a pixel", reason=_TABLE
    )
    fusion_voxel_m: Positive = not_in_paper(
        0.008, "voxel in which points are averaged", reason="a pixel at 3.5 m is 7.5 mm"
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        self._need(
            self.max_size_px == 0 or self.max_size_px >= 64, "max_size_px", "0 (no limit) or at least 64"
        )


@dataclass(frozen=True)
class EvaluationConfig(Section):
    """Cleaning and metrics."""

    crop_half_extent_m: Positive = code(1.5, "evaluation script", "half the side of the cube that is kept")
    ground_ransac_iterations: Count = code(500, "evaluation script", "trials of the ground plane")
    ground_ransac_threshold_m: Positive = code(
        0.03, "evaluation script", "largest distance of ground points to the ground plane"
    )
    ground_max_tilt_deg: Annotated[float, Meta(ge=0, lt=90)] = not_in_paper(
        15.0, "largest tilt of the ground plane", reason="else a facet of the rock may go"
    )
    ground_max_offset_m: NonNegative = not_in_paper(
        0.2, "largest distance of the ground plane from z = 0 below the target"
    )
    sor_neighbours: OneOrMore = code(20, "evaluation script", "neighbours in statistical outlier removal")
    sor_std_ratio: NonNegative = code(
        2.0, "evaluation script", "standard deviations beyond which a point is an outlier"
    )
    floater_radius_m: NonNegative = not_in_paper(
        0.024,
        "gap around floaters (loose points off any plane, small clusters), which are removed; 0: keep them",
        reason="three voxels; T&T precision of four missions: 97.5 to 99.1 % without, 99.6 to 99.9 % with",
    )
    gt_gate_m: NonNegative = text(
        0.0, "IV has no gate", "points farther from the truth are deleted; 0: keep them"
    )
    gt_samples: Annotated[int, Meta(ge=1000)] = code(
        100_000, "evaluation script", "samples of the true surface for the metrics"
    )
    thresholds_mm: tuple[Positive, ...] = code(
        (16.0, 32.0, 48.0, 64.0, 80.0),
        "evaluation script; IV prints two",
        "thresholds of completeness, accuracy and F-score",
    )
    azimuth_sectors: OneOrMore = code(12, "comparison script", "sectors of completeness by azimuth")

    def __post_init__(self) -> None:
        super().__post_init__()
        self._need(len(self.thresholds_mm) > 0, "thresholds_mm", "at least one threshold")
