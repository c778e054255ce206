"""The sections for where photographs are taken: seeds, candidates, scorers, gate and stop."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field
from typing import Annotated, Literal

from msgspec import Meta

from nbv.config.declaration import (
    Count,
    Elevation,
    Elevations,
    NonNegative,
    OneOrMore,
    Positive,
    Section,
    Share,
    TwoOrMore,
    code,
    not_in_paper,
    text,
)
from nbv.config.names import SCORERS, gate_kinds


@dataclass(frozen=True)
class SeedConfig(Section):
    """Phase 1: stratified ring orbit."""

    layout: Literal["rings", "turn"] = text(
        "rings",
        "III",
        "how the seeds fly: on the rings below, or in one turn around the target at even azimuths",
    )
    radius_m: Positive = text(4.0, "III", "distance of the seed orbit to the target")
    ring_elevations_deg: Elevations = text((15.0, 22.0, 29.0, 36.0), "III", "elevations of the seed rings")
    ring_azimuth_counts: tuple[OneOrMore, ...] = text(
        (8, 6, 6, 4),
        "III",
        "views in each seed ring; another number of seeds is shared out in these proportions",
    )
    lowest_deg: Elevation = not_in_paper(
        20.0,
        "elevation of a turn, or of its first ring",
        reason="the mean of the paper's is 24",
        label="elevation of the lowest ring",
    )
    span_deg: float = not_in_paper(
        0.0, "elevation of a turn's second ring minus that of its first", reason="the paper's: 21"
    )
    upper_share: Annotated[float, Meta(ge=0, lt=1)] = not_in_paper(
        0.0,
        "share of a turn's seeds on a second ring, `span_deg` above the first",
        reason="16 at 10° and 9 at 35° are 0.36",
        label="share on the upper ring",
    )
    recentre_after: int = not_in_paper(
        0,
        "seeds after which a target of uncertain position is located and the other seeds are moved to it; "
        "0: after the last",
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        rings = len(self.ring_elevations_deg)
        self._need(rings > 0, "ring_elevations_deg", "at least one ring: no mission begins without seeds")
        counts = self.ring_azimuth_counts
        self._need(len(counts) == rings, "ring_azimuth_counts", "as long as ring_elevations_deg")
        self._need(sum(counts) >= 3, "ring_azimuth_counts", "at least 3 views in all")
        rule = "such that no ring is beyond 90 degrees"
        self._need(self.upper_share == 0 or -90 < self.upper_deg < 90, "span_deg", rule)
        self._need(
            self.recentre_after == 0 or self.recentre_after >= 3,
            "recentre_after",
            "0 (never) or at least 3: fewer photographs make no model",
        )

    @property
    def upper_deg(self) -> float:
        return self.lowest_deg + self.span_deg

    def rings(self, seeds: int) -> tuple[tuple[float, int], ...]:
        """Elevation (degrees) and number of views of each ring that so many ``seeds`` fly, in the order flown."""
        if self.layout == "turn":
            upper = min(round(self.upper_share * seeds), seeds - 1)
            rings = [(self.lowest_deg, seeds - upper), (self.upper_deg, upper)]
        else:
            shares = list(itertools.accumulate(self.ring_azimuth_counts, initial=0))
            ends = [round(seeds * share / shares[-1]) for share in shares]
            numbers = [end - begin for begin, end in itertools.pairwise(ends)]
            rings = list(zip(self.ring_elevations_deg, numbers))
        return tuple((elevation_deg, number) for elevation_deg, number in rings if number)


@dataclass(frozen=True)
class PoolConfig(Section):
    """Phase 2: two-band candidate pool and its feasibility filters."""

    radius_m: Positive = text(3.5, "III", "distance of the candidates to the target")
    lateral_elevations_deg: Elevations = text(
        (10.0, 15.0, 25.0, 35.0), "III", "elevations of the dense lower band"
    )
    lateral_count: Count = code(
        120,
        "mission file",
        "candidates in the lower band, shared among its rings as 1 : 1/2 : 1/3 : 1/4",
    )
    upper_elevations_deg: Elevations = text((35.0, 45.0, 55.0), "III", "elevations of the sparse upper band")
    upper_count: Count = code(50, "mission file", "candidates in the upper band, evenly over its rings")
    min_altitude_m: float = not_in_paper(
        1.3,
        "altitude of the lowest candidate",
        reason="the code's 1.5 drops the 10° ring, which the text has",
    )
    max_altitude_m: float = code(
        20.0,
        "mission file",
        "altitude of the highest candidate; raised if an uncertain target leaves no ring below it",
        label="altitude limit",
    )
    max_elevation_deg: Elevation = not_in_paper(
        89.0,
        "elevation of the highest candidate, seen from the target's centre; holds for targets of any height",
        label="highest elevation",
    )
    max_travel_m: float = code(40.0, "mission file", "farthest candidate from the vehicle")
    min_spacing_m: float = code(0.3, "candidate filter", "least distance between candidates")
    revisit_exclusion_m: float = code(0.6, "mission file", "least distance to an adaptive capture")
    azimuth_sectors: OneOrMore = code(
        8, "mission file", "sectors around the target; candidates in the least photographed come first"
    )
    max_candidates: OneOrMore = code(200, "mission file", "most candidates that are scored")

    def __post_init__(self) -> None:
        super().__post_init__()
        self._need(self.min_altitude_m < self.max_altitude_m, "min_altitude_m", "below max_altitude_m")


@dataclass(frozen=True)
class StopConfig(Section):
    """Phase 2 ends when the budget is used or the sparse cloud has converged."""

    criterion: Literal["both", "budget", "predicted"] = text(
        "both",
        "III",
        "what ends Phase 2: both, d95 of the sparse cloud or the budget (the paper's); budget, it alone; predicted, the "
        "predicted completeness of the dense cloud or the budget (not in the paper)",
    )
    knn_threshold_m: float = code(0.003, "mission file", "d95 below which the sparse cloud has converged")
    knn_neighbours: OneOrMore = code(
        5, "COLMAP settings", "d95 is of the distances to this nearest neighbour"
    )
    knn_region: Literal["all", "box"] = text(
        "all", "III-B, the sparse cloud", "points that count for d95: all, or those in the box"
    )
    predicted_percent: Annotated[float, Meta(gt=0, le=100)] = not_in_paper(
        98.0, "predicted F-score at 48 mm at which criterion predicted ends Phase 2"
    )

    @property
    def may_end_early(self) -> bool:
        """Whether something else than the budget may end Phase 2: the number of photographs is then an outcome."""
        return self.criterion != "budget"


@dataclass(frozen=True)
class Weights(Section):
    """Weights of Eq. 1; only their ratios matter to the ranking."""

    main: NonNegative = text(1.0, "Eq. 1", "weight of the main term", label="weight W_main")
    nov: NonNegative = text(1.2, "Eq. 1", "weight of novelty", label="weight W_nov")
    move: NonNegative = text(0.1, "Eq. 1", "weight of the movement cost", label="weight W_move")
    ang: NonNegative = text(0.4, "Eq. 1", "weight of the angular penalty", label="weight W_ang")


@dataclass(frozen=True)
class SharedTermsConfig(Section):
    """Scales of Eq. 2 to 4 and the point set of Eq. 5 and 8."""

    d_scale_m: Positive = text(
        2.0, "Eq. 2", "distance at which novelty saturates", label="novelty scale d_scale"
    )
    d_travel_m: Positive = text(10.0, "Eq. 3", "scale of the movement cost", label="travel scale d_travel")
    theta_min_deg: Positive = text(
        20.0,
        "Eq. 4",
        "angle to a visited direction below which a view is penalised",
        label="angular penalty θ_min",
    )
    box_half_extent_m: Positive = text(
        2.0, "III-A", "half the side of the box around the target whose points count"
    )
    min_track_length: TwoOrMore = code(2, "scorers", "photographs that must see a point for it to count")


@dataclass(frozen=True)
class CovisConfig(Section):
    weights: Weights = field(default_factory=Weights)


@dataclass(frozen=True)
class BAwareConfig(Section):
    """Eq. 6 and 7."""

    weights: Weights = field(default_factory=Weights)
    alpha_track: NonNegative = text(0.6, "Eq. 6", "weight of short tracks", label="α_τ (track support)")
    alpha_density: NonNegative = text(0.4, "Eq. 6", "weight of low density", label="α_ρ (density)")
    alpha_reprojection: NonNegative = text(
        0.0,
        "Eq. 6 has no such term",
        "weight of the reprojection error",
        label="α_e (reprojection)",
    )
    target_track_length: OneOrMore = text(
        6, "Eq. 6", "track length at which a point is strong", label="target track length T*"
    )
    density_neighbours: OneOrMore = text(5, "Eq. 6", "neighbours whose mean distance is the density")
    theta_low_deg: NonNegative = text(
        5.0,
        "Eq. 7",
        "angle to a ray below which another is redundant",
        label="redundancy floor θ_l",
    )
    theta_saturation_deg: float = text(
        25.0,
        "Eq. 7",
        "angle to all rays beyond which a view gains no more",
        label="saturation angle θ*",
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        self._need(
            self.theta_low_deg < self.theta_saturation_deg, "theta_low_deg", "below theta_saturation_deg"
        )


@dataclass(frozen=True)
class PredictedConfig(Section):
    """Not in the paper: what the dense cloud is predicted to lack (`nbv.scorers.prediction`)."""

    weights: Weights = field(default_factory=Weights)


@dataclass(frozen=True)
class GateConfig(Section):
    """Which ranking is used (Eq. 9 for ``hyb-h``)."""

    kind: str = text(
        "hyb-h",
        "III-B",
        "gate, or a scorer's name for that scorer alone",
        names=gate_kinds,
        plugins=True,
    )
    geometry_scorer: str = text(
        "b-aware",
        "III-B",
        "scorer that Hyb-H and Hyb-O switch to from Covis",
        names=lambda: SCORERS,
        plugins=True,
    )
    budget_fraction: Share = text(
        0.4,
        "Eq. 9",
        "budget fraction below which Hyb-H uses the geometry scorer",
        label="budget fraction f_b",
    )
    d95_m: NonNegative = text(
        0.14,
        "Eq. 9",
        "d95 above which Hyb-H uses the geometry scorer",
        label="KNN distance d95",
    )
    oracle_coverage: Literal["reconstruction", "matchable", "paper-code"] = not_in_paper(
        "reconstruction", "when Hyb-O counts a sample as covered", reason="our reading of III-B"
    )
    oracle_samples: Annotated[int, Meta(ge=100)] = text(
        30_000, "III-B", "samples of the true surface that Hyb-O counts"
    )
    oracle_threshold_m: Positive = text(0.02, "III-B", "distance at which Hyb-O counts a sample as covered")
    oracle_quality_weight: NonNegative = code(
        0.0,
        "scoring.yaml of f3120ba: 0.5",
        "weight of a scorer's own main term in Hyb-O; above 0, the margin decides ties",
    )
