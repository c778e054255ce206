"""Fly the configurations of docs/results/real_photographs.md on sets of photographs, or on rendered rocks.

python -m research.photographs.fly OUT --rock mictlan --replicates 8
python -m research.photographs.fly OUT --rock slab --rock waist --replicates 1
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

# Elevations (deg) of rings, low rings, and the highest of the low pool: what a set has most, and its lower half.
ELEVATIONS = {"sand": (36.0, 28.0, 36.0)}
ON_ROCKS = (22.0, 15.0, 26.0)
MATCHABLE = {
    "gate.kind": "matchable",
    **{f"matchable.weights.{term}": 0.0 for term in ("nov", "move", "ang")},
}
FEW = {"sparse.min_registered_seeds": 6, "sparse.ground_features": 2000}


def altitude_m(elevation_deg: float) -> float:
    """Of the paper's pool, at that elevation."""
    return 0.8 + 3.5 * math.sin(math.radians(elevation_deg))


def configurations(rock: str) -> dict[str, MissionConfig]:
    """The twelve, by name; telemetry is RTK's, which holds the seeds together."""
    middle_deg, low_deg, highest_deg = ELEVATIONS.get(rock, ON_ROCKS)
    base = preset("campaign").with_values({**REDUCED_SFM, "telemetry": "rtk", "pool.min_altitude_m": 0.3})
    low_pool = {"pool.max_altitude_m": altitude_m(highest_deg)}

    def ring(seeds: int, budget: int, **values: Any) -> dict[str, Any]:
        return {
            "seed.count": seeds,
            "seed.lowest_deg": middle_deg,
            "stop.adaptive_budget": budget,
            **(FEW if seeds < 15 else {}),
            **values,
        }

    low = {"seed.lowest_deg": low_deg, **low_pool}
    asked: dict[str, dict[str, Any]] = {
        "hyb-h-24+8": {"stop.adaptive_budget": 8},
        "random-24+8": {"gate.kind": "random"},
        "matchable-24+8": MATCHABLE,
        "oracle-24+8": {"gate.kind": "greedy-oracle", "gate.oracle_coverage": "matchable"},
        "orbit-32": ring(32, 0),
        "matchable-14+12": {**ring(14, 12), **MATCHABLE},
        "random-14+12": {**ring(14, 12), "gate.kind": "random"},
        "oracle-14+12": {**ring(14, 12), "gate.kind": "greedy-oracle", "gate.oracle_coverage": "matchable"},
        "orbit-26": ring(26, 0),
        "matchable-8+11-low": {**ring(8, 11, **low), **MATCHABLE},
        "random-8+11-low": {**ring(8, 11, **low), "gate.kind": "random"},
        "orbit-19-low": ring(19, 0, **{"seed.lowest_deg": low_deg}),
    }
    return {name: base.with_values(values) for name, values in asked.items()}


def main() -> None:
    """Fly what is not there yet."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("--rock", action="append", required=True)
    parser.add_argument("--replicates", type=int, default=8)
    asked = parser.parse_args()
    plan = EvaluationPlan(configurations(asked.rock[0]), tuple(asked.rock), asked.replicates)
    with local_executor(plan.fidelity, 1, 3600.0) as executor:
        print(run_evaluation(plan, asked.out, executor))


if __name__ == "__main__":
    main()
