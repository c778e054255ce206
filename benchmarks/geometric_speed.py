"""Time of geometric missions at the campaign preset (24 + 8) on one core, and where it goes.

    OMP_NUM_THREADS=1 python benchmarks/geometric_speed.py [--rocks boulder waist] [--missions 20]

Every mission has other weights, so that none repeats another's choices by design. The rocks' ray casting and
seed models are in place before the clock starts, as in a campaign after its first missions.
"""

from __future__ import annotations

import argparse
import statistics
import time

import numpy as np
from threadpoolctl import threadpool_limits

from nbv.config import MissionConfig, preset
from nbv.geometric import run_geometric_mission


def configurations(count: int, visibility: str) -> list[MissionConfig]:
    """Spread-out scorer weights on the campaign preset."""
    rng = np.random.default_rng(0)
    base = preset("campaign").with_values({"visibility.mode": visibility})
    paths = [f"{s}.weights.{w}" for s in ("covis", "b_aware") for w in ("nov", "move", "ang")]
    return [
        base.with_values({path: float(10 ** rng.uniform(-2, 0.3)) for path in paths}) for _ in range(count)
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rocks", nargs="+", default=["boulder", "waist"])
    parser.add_argument("--missions", type=int, default=20)
    arguments = parser.parse_args()
    with threadpool_limits(1):
        for visibility in ("frustum", "occlusion"):
            for rock in arguments.rocks:
                started = time.perf_counter()
                run_geometric_mission(preset("campaign"), rock)
                first_s = time.perf_counter() - started
                wall, cpu = [], []
                stages: dict[str, list[float]] = {}
                for config in configurations(arguments.missions, visibility):
                    started, cpu_started = time.perf_counter(), time.process_time()
                    result = run_geometric_mission(config, rock)
                    wall.append((time.perf_counter() - started) * 1e3)
                    cpu.append((time.process_time() - cpu_started) * 1e3)
                    for name, seconds in result.timings_s.items():
                        stages.setdefault(name, []).append(seconds * 1e3)
                print(
                    f"{rock:12s} {visibility:9s} wall: median {statistics.median(wall):6.1f} ms, min {min(wall):6.1f} ms"
                    f"   CPU: median {statistics.median(cpu):6.1f} ms, min {min(cpu):6.1f} ms"
                    f"   (first mission of the process {first_s:.2f} s)"
                )
                means = {name: statistics.mean(values) for name, values in stages.items() if name != "total"}
                print("    " + ", ".join(f"{name} {value:.1f} ms" for name, value in means.items()))


if __name__ == "__main__":
    main()
