"""How many missions under a condition end with a cloud? Seeds and a few captures; the dense stage is cut short.

    OMP_NUM_THREADS=1 python -m research.condition_missions --condition field --replicates 0 1 2 --out field.csv

One row per mission, Hyb-H at preset ``campaign`` with 4 captures, on all procedural rocks; the cloud is not
compared with the rock, which would take half of the time. Goes on where a file ends.
"""

from __future__ import annotations

import argparse
import csv
from pathlib import Path
from typing import Any

from nbv.config import load_condition, preset, under
from nbv.mission.flying import fly_mission
from nbv.photogrammetric.mission import PhotogrammetricFidelity
from nbv.rocks.recipes import RECIPES
from nbv.types import Cloud

SHORT = {
    "stop.adaptive_budget": 4,
    "dense.neighbours": 1,
    "dense.agreeing_views": 2,
}
HEAD = (
    "condition",
    "rock",
    "replicate",
    "status",
    "reason",
    "images",
    "registered images",
    "alignment rms (m)",
)


class Unmeasured(PhotogrammetricFidelity):
    """A mission with photographs whose cloud is only counted."""

    def measure(self, cloud: Cloud) -> dict[str, Any]:
        """How many points there are."""
        return {"points": len(cloud)}


def main() -> None:
    """Fly what is not in the file yet."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--condition", default="field")
    parser.add_argument("--replicates", type=int, nargs="+", default=[*range(6)])
    parser.add_argument("--out", type=Path, required=True)
    arguments = parser.parse_args()
    config = under(preset("campaign"), load_condition(arguments.condition)).with_values(SHORT)
    done = set()
    if arguments.out.exists():
        with arguments.out.open(newline="") as file:
            done = {(row["rock"], int(row["replicate"])) for row in csv.DictReader(file)}
    with arguments.out.open("a", newline="") as file:
        rows = csv.writer(file, lineterminator="\n")
        if not done:
            rows.writerow(HEAD)
        for replicate in arguments.replicates:
            for rock in RECIPES:
                if (rock, replicate) in done:
                    continue
                result = fly_mission(Unmeasured, config, rock, replicate)
                rms_m = f"{result.trace[-1].alignment_rms_m:.3f}" if result.trace else ""
                images = (int(result.costs["images"]), int(result.costs["registered_images"]))
                rows.writerow(
                    [arguments.condition, rock, replicate, result.status, result.reason, *images, rms_m]
                )
                file.flush()


if __name__ == "__main__":
    main()
