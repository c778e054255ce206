"""What missions cost beside an earlier commit, in one run: ratios of CPU seconds, and of equal outcomes.

    python -m research.mission_cost [--mesh scan.ply] [--against a7c3ed2d] [--rounds 3]

Each measurement is a process of its own, the two commits in turn, with stores of their own: a geometric mission on a mesh file
and on a drawn rock, in a process that follows another's; a photogrammetric mission of `make tune` in replicates that the store,
warm from another replicate, does not know. Medians of ``--rounds`` replicates: other programs slow both commits alike. The
share without a stage is what no stage timing holds of the mission's seconds.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from statistics import median
from typing import Any

_MISSION = """
import json, sys, time
from nbv.process import single_thread_environment
single_thread_environment()
import cv2, open3d
from nbv.config import load_condition, preset, under
from nbv.geometric import run_geometric_mission
from nbv.photogrammetric import run_photogrammetric_mission
kind, rock, replicate = sys.argv[1], sys.argv[2], int(sys.argv[3])
config = preset("campaign")
two_numbers = hasattr(config, "photographs")  # which earlier versions said otherwise
if kind == "photogrammetric":
    number = {"photographs": 20, "seeds": 12, "seed.layout": "turn"}
    values = number if two_numbers else {"seed.count": 12, "stop.adaptive_budget": 8}
    values |= {"sparse.ground_features": 2000, "dense.agreeing_views": 3}
    config = under(config, load_condition("indoors")).with_values(values)
run = run_geometric_mission if kind == "geometric" else run_photogrammetric_mission
time.perf_counter = time.process_time
began = time.process_time()
result = run(config, rock, replicate)
taken = time.process_time() - began
stages = dict(result.timings_s)
total = stages.pop("total")
print(json.dumps({"cpu_s": taken, "without_stage": 1 - sum(stages.values()) / total, "metrics": result.metrics,
                  "stages": stages}))
"""


def measure(tree: Path, home: Path, *what: Any) -> dict[str, Any]:
    """One mission by the code in ``tree`` with the store in ``home``."""
    environment = {**os.environ, "PYTHONPATH": str(tree), "GATETUNE_HOME": str(home)}
    ran = subprocess.run(
        [sys.executable, "-P", "-c", _MISSION, *map(str, what)],
        env=environment,
        stdout=subprocess.PIPE,
        check=True,
    )
    found: dict[str, Any] = json.loads(ran.stdout.splitlines()[-1])
    return found


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--mesh", type=Path, help="default: no mission on a mesh file")
    parser.add_argument("--against", default="a7c3ed2d")
    parser.add_argument("--rounds", type=int, default=1)
    parser.add_argument("--kinds", nargs="+", default=["geometric", "photogrammetric"])
    asked = parser.parse_args()
    here = Path(__file__).resolve().parents[1]
    with tempfile.TemporaryDirectory(prefix="mission-cost-") as folder:
        before, after = Path(folder) / "before", here
        before.mkdir()
        archive = subprocess.run(
            ["git", "archive", asked.against], cwd=here, stdout=subprocess.PIPE, check=True
        )
        subprocess.run(["tar", "x", "-C", str(before)], input=archive.stdout, check=True)
        missions = [("geometric", "boulder-21"), ("photogrammetric", "slab")]
        if asked.mesh is not None:
            missions.insert(0, ("geometric", str(asked.mesh.resolve())))
        print(
            "|mission|before, CPU s|after|times|without a stage, before|after|same outcome|\n|-|-:|-:|-:|-:|-:|-|"
        )
        for kind, rock in missions:
            if kind not in asked.kinds:
                continue
            homes = {tree: Path(folder) / f"home-{tree.name}" for tree in (before, after)}
            for tree, home in homes.items():
                measure(tree, home, kind, rock, 0)
            pairs = [
                tuple(measure(tree, home, kind, rock, replicate) for tree, home in homes.items())
                for replicate in range(1, asked.rounds + 1)
            ]
            cpu_s = [median(pair[side]["cpu_s"] for pair in pairs) for side in (0, 1)]
            without = [100 * median(pair[side]["without_stage"] for pair in pairs) for side in (0, 1)]
            times = median(old["cpu_s"] / new["cpu_s"] for old, new in pairs)
            same = "yes" if all(old["metrics"] == new["metrics"] for old, new in pairs) else "no"
            print(
                f"|{kind}, {Path(rock).stem}|{cpu_s[0]:.2f}|{cpu_s[1]:.2f}|{times:.2f}|{without[0]:.1f} %|"
                f"{without[1]:.1f} %|{same}|",
                flush=True,
            )
            for side, name in enumerate(("before", "after")):
                stages = {
                    n: median(pair[side]["stages"].get(n, 0.0) for pair in pairs)
                    for n in pairs[0][side]["stages"]
                }
                print(
                    f"{name}: " + ", ".join(f"{n} {s:.2f}" for n, s in sorted(stages.items())),
                    file=sys.stderr,
                )


if __name__ == "__main__":
    main()
