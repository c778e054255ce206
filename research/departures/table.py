"""The departures of the authors' public code, and options of ours, that the study knows."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Literal

from nbv.config import PRESETS, MissionConfig

Origin = Literal["public code", "paper's text", "ours"]


@dataclass(frozen=True)
class Departure:
    """One thing that differs from the base."""

    name: str
    what: str  # one line, for the report
    origin: Origin  # who does it this way
    values: dict[str, Any] = field(default_factory=dict)
    gate: str = ""  # flown with, and compared with, this gate instead of the base's
    surface: str = ""  # read another surface than the study's

    @property
    def reads_only(self) -> bool:
        """Whether the base's own missions answer it."""
        return not self.values

    def applies(self, base: MissionConfig, surface: str) -> bool:
        """Whether it changes anything about ``base`` as measured on ``surface``."""
        if self.reads_only:
            return self.surface != surface
        return base.with_values(self.values) != base


# What preset `paper-code` executes, part by part: what a base (`paper`, `campaign`) has already is not flown again.
_ALPHAS = {"b_aware.alpha_track": 0.5, "b_aware.alpha_density": 0.3, "b_aware.alpha_reprojection": 0.2}
_NO_LOW_RING = {"pool.min_altitude_m": 1.5}
_ALL_POINTS = {"stop.knn_region": "all"}
_FRUSTUM_ORACLE = {"gate.oracle_coverage": "paper-code"}
_EXHAUSTIVE = {"sparse.max_pair_angle_deg": 180.0, "sparse.max_pairs": 0}  # as preset `paper` does
_MORE_FEATURES = {"sparse.max_features": 16384}
_BUDGET_ONLY = {"stop.criterion": "budget"}
PAPER_CODE: dict[str, Any] = {**PRESETS["paper-code"].values, **_ALL_POINTS, **_EXHAUSTIVE}

DEPARTURES: dict[str, Departure] = {
    d.name: d
    for d in (
        Departure(
            "alphas", "weakness weights 0.5 / 0.3 / 0.2 (with reprojection error)", "public code", _ALPHAS
        ),
        Departure(
            "low-ring-rejected",
            "10° ring rejected by the altitude limit: 105 candidates, not 163",
            "public code",
            _NO_LOW_RING,
        ),
        Departure(
            "d95-all-points",
            "d95 of the gate over all sparse points, not those in the box",
            "public code",
            _ALL_POINTS,
        ),
        Departure(
            "frustum-oracle",
            "Hyb-O whose samples are covered by the frustum of any visited view",
            "public code",
            _FRUSTUM_ORACLE,
            gate="hyb-o",
        ),
        Departure(
            "exhaustive-matching", "every photograph matched with every other", "public code", _EXHAUSTIVE
        ),
        Departure("features-16384", "up to 16,384 features a photograph", "public code", _MORE_FEATURES),
        Departure(
            "stop-on-budget",
            "stop when the budget is used, never on the KNN distance",
            "public code",
            _BUDGET_ONLY,
        ),
        Departure(
            "straight-legs",
            "straight legs, through the rock if need be",
            "public code",
            {"flight.keep_out_height_m": 0.0},
        ),
        Departure(
            "gt-gate",
            "points farther than 50 mm from the ground truth deleted before the metrics",
            "public code",
            {"evaluation.gt_gate_m": 0.05},
        ),
        Departure(
            "whole-surface",
            "measured on the whole surface, underside included (no flight)",
            "public code",
            surface="whole",
        ),
        Departure(
            "stop-both",
            "stop on the KNN distance or the budget, whichever comes first",
            "paper's text",
            {"stop.criterion": "both"},
        ),
        Departure(
            "d95-box", "d95 of the gate over the points in the box only", "ours", {"stop.knn_region": "box"}
        ),
        Departure(
            "doubled-image",
            "features of the doubled image too (COLMAP's default, presets `paper` and `paper-code`)",
            "public code",
            {"sparse.first_octave": -1},
        ),
        Departure(
            "single-image",
            "no features of the doubled image (preset `campaign`)",
            "ours",
            {"sparse.first_octave": 0},
        ),
        Departure(
            "paper-code",
            "all that preset `paper-code` changes, together, 50 mm gate included",
            "public code",
            PAPER_CODE,
        ),
        Departure(
            "paper-code-ungated",
            "the same flight, measured without the 50 mm gate",
            "public code",
            {**PAPER_CODE, "evaluation.gt_gate_m": 0.0},
        ),
        Departure(
            "paper-code-oracle",
            "the same together under Hyb-O, measured without the 50 mm gate",
            "public code",
            {**PAPER_CODE, "evaluation.gt_gate_m": 0.0},
            gate="hyb-o",
        ),
    )
}
