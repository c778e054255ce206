"""What do stereo pairs nearly in line with the target add, where poses are free of the exact rings?

    OMP_NUM_THREADS=1 python -m research.field_pair_angle --out angles.csv

Each mission is flown once for each least angle between a pair's baseline and the line to the target; the views are the
same, since depths are not looked at in flight. Dense stage in CPU seconds, scores after registration to the true surface.
"""

from __future__ import annotations

import argparse
import csv
import time
from pathlib import Path

import nbv.photogrammetric.reconstructor as reconstructor
from nbv.config import load_condition, preset, under
from nbv.photogrammetric import run_photogrammetric_mission

HEAD = (
    "rock",
    "replicate",
    "least angle (deg)",
    "dense CPU s",
    "registered observable F-score 16 mm (%)",
    "registered observable F-score 48 mm (%)",
)
ROCKS = ("boulder", "slab", "waist", "cleft", "arch", "fin", "cairn", "vesicular")


def main() -> None:
    """One row for each mission and angle."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--condition", default="field")
    parser.add_argument("--rocks", nargs="+", default=ROCKS)
    parser.add_argument("--replicates", type=int, nargs="+", default=[0, 1])
    parser.add_argument("--angles", type=float, nargs="+", default=[30.0, 40.0])
    parser.add_argument("--out", type=Path, required=True)
    arguments = parser.parse_args()
    time.perf_counter = time.process_time
    config = under(preset("campaign"), load_condition(arguments.condition))
    with arguments.out.open("w", newline="") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(HEAD)
        for rock in arguments.rocks:
            for replicate in arguments.replicates:
                for angle_deg in arguments.angles:
                    reconstructor.LEAST_BASELINE_ANGLE_DEG = angle_deg
                    result = run_photogrammetric_mission(config, rock, replicate)
                    scores = result.metrics["registered"]["observable"]
                    rows.writerow(
                        [
                            rock,
                            replicate,
                            f"{angle_deg:g}",
                            round(result.timings_s["dense"], 2),
                            *(round(scores[f"f_score_{mm}mm"], 3) for mm in (16, 48)),
                        ]
                    )
                    file.flush()


if __name__ == "__main__":
    main()
