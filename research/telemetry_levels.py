"""Missions with telemetry that errs: do they end with a model, and what is the cloud worth in place and in shape?

    OMP_NUM_THREADS=1 python -m research.telemetry_levels --rock slab cavern --out docs/results/data/telemetry_levels.csv

Hyb-H at preset ``campaign``, one mission per rock, level and replicate. ``georeferenced``: the cloud where telemetry
places it. ``registered``: after the similarity that fits it best to the true surface. Whole surface.
"""

from __future__ import annotations

import argparse
import csv
from pathlib import Path

from nbv.config import TELEMETRY_LEVELS, preset
from nbv.photogrammetric import run_photogrammetric_mission

METRICS = ("f_score_48mm", "completeness_48mm", "c2c_mean_mm")


def main() -> None:
    """Fly and write a row per mission."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--rock", nargs="+", default=["slab", "cavern"])
    parser.add_argument("--level", nargs="+", default=[*TELEMETRY_LEVELS])
    parser.add_argument("--replicates", type=int, default=1)
    parser.add_argument("--out", type=Path, required=True)
    arguments = parser.parse_args()
    places = ("georeferenced", "registered")
    head = [f"{place} {metric}" for place in places for metric in METRICS]
    with arguments.out.open("w", newline="") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(["level", "rock", "replicate", "status", "alignment rms (m)", *head])
        for level in arguments.level:
            config = preset("campaign").with_values({"telemetry": level})
            for rock in arguments.rock:
                for replicate in range(arguments.replicates):
                    result = run_photogrammetric_mission(config, rock, replicate)
                    found = result.metrics.get("whole", {})
                    moved = result.metrics.get("registered", {}).get("whole", found)
                    values = [f"{part[m]:.1f}" if part else "" for part in (found, moved) for m in METRICS]
                    rms_m = f"{result.trace[-1].alignment_rms_m:.3f}" if result.trace else ""
                    rows.writerow([level, rock, replicate, result.reason or result.status, rms_m, *values])
                    file.flush()


if __name__ == "__main__":
    main()
