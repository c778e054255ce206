"""Hyb-O, Hyb-H and random views as the public code flies them, at both of its versions: paired differences over rocks.

    python -m research.hyb_o_of_the_code --rock slab --rock vesicular [--fidelity photogrammetric] [--replicates 8] [--out FILE.csv]

Eight adaptive photographs, preset `campaign`'s way to reconstruct; a pair is a (rock, replicate).
"""

from __future__ import annotations

import argparse
import csv
import itertools
from pathlib import Path
from typing import Any

import numpy as np

from nbv.config import PRESETS, preset
from nbv.threads import single_thread_environment
from tuner.evaluation.baselines import baseline_configs
from tuner.evaluation.comparison import mean_interval
from tuner.missions.registry import mission_function

# What the first author's later repository (2026-06) changes in preset paper-code.
VERSIONS: dict[str, dict[str, Any]] = {
    "paper-code": {},
    "paper-code-2026-06": {
        "stop.criterion": "both",
        "seed.ring_elevations_deg": (12.0, 19.0, 27.0, 34.0),
        "gate.oracle_quality_weight": 0.5,
    },
}
STRATEGIES = ("hyb-o", "hyb-h", "covis", "random")
SHORT = {
    "stop.adaptive_budget": 8,
    **{
        k: v
        for k, v in PRESETS["campaign"].values.items()
        if k.startswith(("sparse.", "dense.", "evaluation."))
    },
}


def missions(
    name: str, rocks: list[str], replicates: int, fidelity: str
) -> dict[tuple[str, str, int], tuple[float, float]]:
    """F-score @ 48 mm and percent of captures flown with B-aware, by (strategy, rock, replicate)."""
    base = preset("paper-code").with_values({**VERSIONS[name], **SHORT})
    run_missions, found = mission_function(fidelity), {}
    for strategy, config in baseline_configs(list(STRATEGIES), base).items():
        for rock, replicate in itertools.product(rocks, range(replicates)):
            evaluated = run_missions(config, rock, replicate, None)
            if evaluated.status == "failed":
                continue
            share = 100 * float(np.mean([entry.scorer == "b-aware" for entry in evaluated.trace]))
            found[strategy, rock, replicate] = evaluated.metrics["observable"]["f_score_48mm"], share
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--rock", action="append", required=True, help="rock or mesh file, repeatable")
    parser.add_argument("--fidelity", default="geometric", choices=("geometric", "photogrammetric"))
    parser.add_argument("--replicates", type=int, default=8)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    single_thread_environment()
    rows: list[dict[str, Any]] = []
    for name in VERSIONS:
        found = missions(name, options.rock, options.replicates, options.fidelity)
        for reference in STRATEGIES[1:]:
            pairs: dict[str, list[float]] = {}
            for rock, k in itertools.product(options.rock, range(options.replicates)):
                if ("hyb-o", rock, k) in found and (reference, rock, k) in found:
                    pairs.setdefault(rock, []).append(
                        found["hyb-o", rock, k][0] - found[reference, rock, k][0]
                    )
            interval = mean_interval(pairs)
            assert interval is not None, "no pair of missions ended well"
            rows.append(
                {
                    "preset": name,
                    "fidelity": options.fidelity,
                    "difference": f"hyb-o minus {reference}",
                    "F-score @ 48 mm (points)": round(interval.mean, 2),
                    "low": None if interval.low is None else round(interval.low, 2),
                    "high": None if interval.high is None else round(interval.high, 2),
                    "pairs": sum(map(len, pairs.values())),
                    "B-aware flown by hyb-o (%)": round(
                        float(np.mean([v[1] for key, v in found.items() if key[0] == "hyb-o"])), 1
                    ),
                }
            )
            print(rows[-1])
    if options.out is not None:
        with options.out.open("w", newline="") as file:
            writer = csv.DictWriter(file, rows[0], lineterminator="\n")
            writer.writeheader()
            writer.writerows(rows)


if __name__ == "__main__":
    main()
