"""Speed and memory of missions: throughput, workers, growth over a mission, memory.

    OMP_NUM_THREADS=1 python -m research.mission_speed [--parts stages workers captures] [--out FILE.json]

- ``stages``: one campaign mission (24 + 8) with nothing cached; with a warm store that has not seen its sequence
  of views; with one that has. Time by stage, CPU, wall, peak memory.
- ``workers``: the same set of campaign missions (spread-out weights, several rocks) by the tuner's executor with
  1 and with 2 worker processes. The store is warm, the sequences are forgotten before each round, so that every
  mission maps, reconstructs and measures. A third round with the sequences known.
- ``captures``: a mission of preset paper-reduced (24 + 40), nothing cached: CPU seconds of each capture.

Rounds of "workers" repeat ``--rounds`` times, 1 and 2 workers in turn. "Per hour" is from the wall clock and says
what this machine gave while others used it too; "per hour of CPU" is 2 x 3600 over the CPU seconds of a mission with
2 workers: what two cores of its own would give.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import tempfile
import time
from pathlib import Path
from typing import Any

from nbv.config import MissionConfig, load_condition, preset, under
from nbv.mission.result import MissionResult
from nbv.threads import single_thread_environment
from research.fresh_process import MeasuredMission, forget_sequences, run_in_fresh_process


def stages(home: Path, rock: str, name: str = "campaign") -> dict[str, Any]:
    """One mission cold and warm."""
    config = preset(name)
    evaluated: dict[str, MeasuredMission] = {"cold": run_in_fresh_process(config, rock, 0, home)}
    forget_sequences(home)
    evaluated["warm, new sequence"] = run_in_fresh_process(config, rock, 0, home)
    evaluated["warm, known sequence"] = run_in_fresh_process(config, rock, 0, home)
    same = all(f.result.metrics == evaluated["cold"].result.metrics for f in evaluated.values())
    print(f"\n{name} preset on {rock}, CPU seconds by stage (same metrics to the bit: {same})\n")
    names = sorted({s for f in evaluated.values() for s in f.result.timings_s} - {"total"})
    print("| stage | " + " | ".join(evaluated) + " |\n|---" * 1 + "|---" * len(evaluated) + "|")
    for stage in names:
        print(
            f"| {stage} | "
            + " | ".join(f"{f.result.timings_s.get(stage, 0):.2f}" for f in evaluated.values())
            + " |"
        )
    for label, get in (("wall s", "wall_s"), ("CPU s", "cpu_s"), ("peak memory MB", "peak_rss_mb")):
        print(
            f"| **{label}** | " + " | ".join(f"{getattr(f, get):.1f}" for f in evaluated.values()) + " |",
            flush=True,
        )
    return {
        k: {
            "wall_s": f.wall_s,
            "cpu_s": f.cpu_s,
            "peak_rss_mb": f.peak_rss_mb,
            "timings_s": f.result.timings_s,
        }
        for k, f in evaluated.items()
    }


def spread_out(count: int, condition: str) -> list[MissionConfig]:
    """Campaign configurations, under a condition, whose weights differ by orders of magnitude."""
    import numpy as np

    rng = np.random.default_rng(0)
    paths = [f"{s}.weights.{w}" for s in ("covis", "b_aware") for w in ("nov", "move", "ang")]
    base = under(preset("campaign"), load_condition(condition))
    return [
        base.with_values({path: float(10 ** rng.uniform(-2, 0.3)) for path in paths}) for _ in range(count)
    ]


def fly_all(jobs: list[tuple[MissionConfig, str]], workers: int, folder: Path) -> dict[str, float]:
    """Seconds for all missions with so many workers; imports and the workers' start come before the clock."""
    from tuner.missions.executors import LocalProcessExecutor
    from tuner.missions.job import MissionJob

    executor = LocalProcessExecutor(
        workers, preload=("photogrammetric", "research.fresh_process:timed_mission")
    )
    queue = [
        MissionJob(
            f"m{i:02d}",
            config,
            rock,
            0,
            folder / f"m{i:02d}",
            fidelity="research.fresh_process:timed_mission",
        )
        for i, (config, rock) in enumerate(jobs)
    ]
    try:
        # Starts the server, which imports everything before it forks; the job itself fails at once.
        executor.submit(
            MissionJob(
                "warm-up",
                preset("campaign"),
                "no such rock",
                0,
                folder / "warm-up",
                fidelity="research.fresh_process:timed_mission",
            )
        )
        while not executor.wait_any(1.0):
            pass
        waiting, load_trial, running = list(queue), 0, 0
        started = time.perf_counter()
        while load_trial < len(queue):
            while waiting and running < workers:
                executor.submit(waiting.pop(0))
                running += 1
            ended = len(executor.wait_any(60.0))
            load_trial, running = load_trial + ended, running - ended
        wall = time.perf_counter() - started
    finally:
        executor.close()
    results = [MissionResult.load(job.directory) for job in queue]
    failed = [r.reason for r in results if r.status == "failed"]
    if failed:
        raise SystemExit(f"{len(failed)} missions failed: {failed}")
    return {
        "workers": workers,
        "missions": len(queue),
        "wall_s": wall,
        "cpu_s": sum(r.costs["cpu_s"] for r in results),
        "peak_rss_mb": max(r.costs["peak_rss_mb"] for r in results),
    }


def workers(
    home: Path, rocks: list[str], count: int, rounds: int, folder: Path, condition: str
) -> dict[str, Any]:
    """Throughput with 1 and 2 workers."""
    jobs = [(config, rocks[i % len(rocks)]) for i, config in enumerate(spread_out(count, condition))]
    fly_all(jobs, 2, folder / "fill")  # photographs, features, pairs, seed models
    table: list[dict[str, Any]] = []
    for turn in range(rounds):
        for n in (1, 2):
            forget_sequences(home)
            table.append({"sequences": "new", **fly_all(jobs, n, folder / f"new{turn}{n}")})
    table.append({"sequences": "known", **fly_all(jobs, 2, folder / "known")})
    print(f"\n{count} campaign missions (24 + 8, dense and metrics) on {', '.join(rocks)}, store warm\n")
    print(
        "| sequences of views | workers | wall s a mission | missions an hour | CPU s a mission | missions an hour of 2 whole cores | peak MB |"
    )
    print("|---|---|---|---|---|---|---|")
    for row in table:
        m = row["missions"]
        print(
            f"| {row['sequences']} | {row['workers']} | {row['wall_s'] / m:.1f} | {3600 * m / row['wall_s']:.0f} | "
            f"{row['cpu_s'] / m:.1f} | {2 * 3600 * m / row['cpu_s']:.0f} | {row['peak_rss_mb']:.0f} |"
        )
    one, two = ([r for r in table if r["sequences"] == "new" and r["workers"] == n] for n in (1, 2))
    ratio = statistics.median(a["wall_s"] for a in one) / statistics.median(b["wall_s"] for b in two)
    cpu = 2 * statistics.median(a["cpu_s"] for a in one) / statistics.median(b["cpu_s"] for b in two)
    print(
        f"\n2 workers against 1: {ratio:.2f} times by the wall clock; {cpu:.2f} times if each worker had a core to "
        "itself (twice the CPU seconds of a mission alone over those of one beside another)",
        flush=True,
    )
    return {"rounds": table, "ratio_wall": ratio, "ratio_cpu": cpu}


def captures(home: Path, rock: str) -> dict[str, Any]:
    """Cost of each capture of a mission of preset paper-reduced."""
    evaluated = run_in_fresh_process(preset("paper-reduced"), rock, 0, home)
    costs = evaluated.capture_cpu_s
    first, last = statistics.mean(costs[:10]), statistics.mean(costs[-10:])
    print(
        f"\npaper-reduced mission, 24 + {len(costs)}, nothing cached, on {rock}: {evaluated.cpu_s:.1f} s CPU, {evaluated.wall_s:.1f} s "
        f"wall, peak {evaluated.peak_rss_mb:.0f} MB; CPU s of a capture: mean of the first 10 {first:.2f}, of the last 10 "
        f"{last:.2f}, growth {last / first:.2f} times\n" + ", ".join(f"{c:.2f}" for c in costs),
        flush=True,
    )
    return {
        "capture_cpu_s": costs,
        "growth": last / first,
        "cpu_s": evaluated.cpu_s,
        "wall_s": evaluated.wall_s,
        "peak_rss_mb": evaluated.peak_rss_mb,
        "timings_s": evaluated.result.timings_s,
    }


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--parts",
        nargs="+",
        default=["stages", "workers", "captures"],
        choices=["stages", "workers", "captures"],
    )
    parser.add_argument("--rocks", nargs="+", default=["boulder", "slab"])
    parser.add_argument("--missions", type=int, default=8)
    parser.add_argument("--rounds", type=int, default=2)
    parser.add_argument("--preset", default="campaign", help="of part stages")
    parser.add_argument("--condition", default="ideal", help="of part workers")
    parser.add_argument("--home", type=Path, help="rocks, caches and store; default: an empty one")
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    single_thread_environment()
    root = str(Path(__file__).resolve().parent.parent)
    os.environ["PYTHONPATH"] = os.pathsep.join([root, os.environ.get("PYTHONPATH", "")])
    report: dict[str, Any] = {}
    with tempfile.TemporaryDirectory(prefix="mission-speed-") as name:
        folder = Path(name)
        home = arguments.home or folder / "home"
        os.environ["GATETUNE_HOME"] = str(home)
        if "stages" in arguments.parts:
            report["stages"] = stages(home, arguments.rocks[0], arguments.preset)
        if "workers" in arguments.parts:
            report["workers"] = workers(
                home, arguments.rocks, arguments.missions, arguments.rounds, folder, arguments.condition
            )
        if "captures" in arguments.parts:
            report["captures"] = captures(folder / "empty", arguments.rocks[0])
        if arguments.out:
            arguments.out.write_text(json.dumps(report, indent=1))


if __name__ == "__main__":
    main()
