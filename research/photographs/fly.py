"""Fly the configurations of docs/results/real_photographs.md on sets of photographs, or on rocks.

python -m research.photographs.fly OUT --rock mictlan --replicates 8
python -m research.photographs.fly OUT --rock slab --rock waist --fidelity geometric
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import Any

from nbv.config import MissionConfig, preset
from nbv.config.presets import REDUCED_SFM
from tuner.evaluation.flying import run_evaluation
from tuner.evaluation.plan import EvaluationPlan
from tuner.missions.executors import local_executor

# Elevations (deg): of the ring, of the low ring, and the highest of the low pool. Nobody photographed the sand from below 28.
ELEVATIONS = {"sand": (36.0, 28.0, 36.0)}
ELSEWHERE = (22.0, 14.0, 26.0)
MATCHABLE = {
    "gate.kind": "matchable",
    **{f"matchable.weights.{term}": 0.0 for term in ("nov", "move", "ang")},
}
GROUND = {"sparse.ground_features": 2000}
FEWEST_BY_SIFT = 15  # seeds; farther apart they need features of the ground
ORACLE = {"gate.kind": "greedy-oracle", "gate.oracle_coverage": "matchable"}


def altitude_m(elevation_deg: float) -> float:
    """Of the paper's pool, at that elevation."""
    return 0.8 + 3.5 * math.sin(math.radians(elevation_deg))


def configurations(rock: str) -> dict[str, MissionConfig]:
    """By name; telemetry is RTK's, which holds the seeds together, and three views must agree, as in a set's reference."""
    middle_deg, low_deg, highest_deg = ELEVATIONS.get(rock, ELSEWHERE)
    base = preset("campaign").with_values(
        {
            **REDUCED_SFM,
            "telemetry": "rtk",
            "pool.min_altitude_m": 0.3,
            "dense.agreeing_views": 3,
            "sparse.max_features": 2048,
            "sparse.min_registered_seeds": 6,
            "seed.lowest_deg": middle_deg,
        }
    )
    low = {"seed.lowest_deg": low_deg, "pool.max_altitude_m": altitude_m(highest_deg)}

    def plan(seeds: int, budget: int, **values: Any) -> dict[str, Any]:
        ground = GROUND if seeds < FEWEST_BY_SIFT else {}
        return {"seed.count": seeds, "stop.adaptive_budget": budget, **ground, **values}

    asked: dict[str, dict[str, Any]] = {
        **{f"{gate}-16+8": plan(16, 8, **{"gate.kind": gate}) for gate in ("covis", "b-aware", "hyb-h")},
        "hyb-o-16+8": plan(16, 8, **{"gate.kind": "hyb-o"}),
        "matchable-16+8": plan(16, 8, **MATCHABLE),
        "predicted-16+8": plan(16, 8, **{"gate.kind": "predicted"}),
        "random-16+8": plan(16, 8, **{"gate.kind": "random"}),
        "oracle-16+8": plan(16, 8, **ORACLE),
        "orbit-24": plan(24, 0),
        # `make tune`'s, and what its 21 photographs became.
        "matchable-8+11-low": plan(8, 11, **low, **MATCHABLE),
        "random-8+11-low": plan(8, 11, **low, **{"gate.kind": "random"}),
        "orbit-19-low": plan(19, 0, **{"seed.lowest_deg": low_deg}, **GROUND),
        "hyb-h-13+8-low": plan(13, 8, **low, **{"gate.kind": "hyb-h"}),
    }
    return {name: base.with_values(values) for name, values in asked.items()}


def main() -> None:
    """Fly what is not there yet."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("--rock", action="append", required=True)
    parser.add_argument("--replicates", type=int, default=8)
    parser.add_argument("--first", type=int, default=0, help="the first replicate")
    parser.add_argument("--fidelity", default="photogrammetric")
    parser.add_argument("--plan", nargs="+", help="only these configurations")
    asked = parser.parse_args()
    plans = configurations(asked.rock[0])
    plan = EvaluationPlan(
        {name: plans[name] for name in asked.plan or plans},
        tuple(asked.rock),
        asked.replicates,
        asked.first,
        asked.fidelity,
    )
    with local_executor(plan.fidelity, 1, 3600.0) as executor:
        print(run_evaluation(plan, asked.out, executor))


if __name__ == "__main__":
    main()
