"""A mission function whose departures have known effects, with a trace of decisions.

F-score: 60 + a draw per (rock, replicate) that all configurations share, + 2 with the public code's alphas, + a
draw per (configuration, rock, replicate) with mean -4 without the low ring. Features and matching do nothing.
The 50 mm gate adds 3 points, the whole surface takes 5.

Views: cand_0, cand_1, ... in this order; alphas replace the last by another, the missing low ring all of them.
Rewards (B-aware, Covis) by coverage: see ``REWARDS``.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path

import fake_missions
from fake_missions import note_flight, well_flown

from nbv.config import MissionConfig
from nbv.errors import MissionFailure
from nbv.mission.result import IterationRecord, MissionResult

BUDGET = 4
REWARDS = {
    "reconstruction": [(5, 3), (2, 4), (1, 1), (6, 1)],  # prefers B-aware twice, Covis once, one tie
    "seen": [(3, 2), (0, 0), (1, 0), (0, 0)],  # saturates at the last capture: the second was not the end
    "matchable": [(1, 2), (1, 2), (3, 3), (0, 0)],
    "paper-code": [(0, 0)] * 4,
}
SAME_CANDIDATE_AT = 2  # both scorers choose the same one


def draw(*key: object) -> float:
    """A normal draw that is the same for the same key."""
    return float(fake_missions.draw(*key).normal())


def fake_mission(
    config: MissionConfig, rock: str, replicate: int, directory: Path, *, keep: str = "summary"
) -> MissionResult:
    """A mission that takes no time."""
    if rock == "failing" and config.b_aware.alpha_track == 0.5:
        raise MissionFailure("seed_model_failed", "no seed model")
    f_score = 60.0 + draw("slot", rock, replicate)
    alphas, ring_gone = config.b_aware.alpha_track == 0.5, config.pool.min_altitude_m == 1.5
    if alphas:
        f_score += 2.0
    if ring_gone:
        f_score += -4.0 + 0.3 * draw("ring", rock, replicate)
    chosen = [f"cand_{i}" for i in range(BUDGET)]
    if alphas:
        chosen[-1] = "cand_99"
    if ring_gone:
        chosen = [f"cand_5{i}" for i in range(BUDGET)]
    if config.evaluation.gt_gate_m > 0:
        f_score += 3.0
    surfaces = {"observable": scores(f_score), "whole": scores(f_score - 5.0)}
    note_flight(directory)
    return dataclasses.replace(
        well_flown(config, rock, replicate, surfaces),
        trace=[record(config, i, chosen[i]) for i in range(BUDGET)],
        timings_s={},
        costs={"wall_s": 10.0, "flight_time_s": 150.0},
    )


def scores(f_score: float) -> dict[str, float]:
    return {
        "f_score_48mm": f_score,
        "completeness_48mm": f_score - 1,
        "accuracy_48mm": f_score + 1,
        "c2c_mean_mm": 100 - f_score,
        "hausdorff_gt_to_cloud_mm": 200 - f_score,
    }


def record(config: MissionConfig, i: int, chosen: str) -> IterationRecord:
    kind = config.gate.kind
    b_aware, covis = REWARDS[config.gate.oracle_coverage][i]
    scorer = {"hyb-o": "b-aware" if b_aware > covis else "covis", "hyb-h": "b-aware" if i < 1 else "covis"}
    details = {"covered_fraction": 0.1 * (i + 1)} if kind == "greedy-oracle" else {}
    top = {"b-aware": {"candidate": "x"}, "covis": {"candidate": "x" if i == SAME_CANDIDATE_AT else "y"}}
    return IterationRecord(
        iteration=i,
        pool_size=9,
        pool_counts={},
        d95_m=0.2,
        n_points=9,
        n_registered=9,
        alignment_rms_m=0.0,
        scorer=scorer.get(kind, kind),
        reason="",
        gate_details=details,
        oracle_rewards={"b-aware": float(b_aware), "covis": float(covis)},
        features={},
        top=top,
        chosen=chosen,
        registered=True,
        message="",
        leg_duration_s=1.0,
        leg_length_m=1.0,
        update_s=0.0,
        planning_s=0.0,
    )
