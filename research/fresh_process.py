"""One mission in a process of its own, timed from inside: what the speed benchmarks share."""

from __future__ import annotations

import itertools
import multiprocessing
import os
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from nbv.cache import home
from nbv.config import MissionConfig
from nbv.mission.result import MissionResult
from nbv.threads import single_thread_environment

# What nbv.photogrammetric keeps of whole missions; the rest of the store is parts that missions share.
SEQUENCE_KINDS = ("sequence-models", "clouds", "evaluations")


@dataclass(frozen=True)
class MeasuredMission:
    """A mission and what it cost. Imports come before the clock: a campaign's workers fork with them."""

    result: MissionResult  # its stage timings are CPU seconds
    wall_s: float
    cpu_s: float
    peak_rss_mb: float
    capture_cpu_s: list[float]  # of each adaptive capture: planning, flight, photograph, update


def run_in_fresh_process(
    config: MissionConfig,
    rock: str,
    replicate: int,
    home: Path,
    directory: Path | None = None,
    keep: Literal["all", "summary"] = "summary",
) -> MeasuredMission:
    """Run with the rocks, caches and store of ``home``, on one thread."""
    single_thread_environment()  # inherited by the child, before it imports anything
    os.environ["GATETUNE_HOME"] = str(home)
    context = multiprocessing.get_context("spawn")
    receiver, sender = context.Pipe(duplex=False)
    child = context.Process(target=_fly, args=(config, rock, replicate, directory, keep, sender))
    child.start()
    sender.close()
    try:
        evaluated: MeasuredMission = receiver.recv()
    finally:
        child.join()
    return evaluated


def fly_for_record(
    config: MissionConfig, rock: str, replicate: int, what: dict[str, Any], metrics: Sequence[str]
) -> tuple[MeasuredMission, dict[str, Any]]:
    """Run with the user's rocks and store; the flight, and its line of a benchmark's record.

    ``what`` tells the line from others of its rock and replicate; ``metrics`` are of the observable surface.
    ``SystemExit`` where the mission fails.
    """
    evaluated = run_in_fresh_process(config, rock, replicate, home())
    result = evaluated.result
    if result.status == "failed":
        raise SystemExit(f"{rock}, replicate {replicate}, {what}: {result.reason}: {result.message}")
    return evaluated, {
        "rock": Path(rock).stem,
        "replicate": replicate,
        **what,
        "cpu_s": evaluated.cpu_s,
        "timings_s": dict(result.timings_s),
        "views": [step.chosen for step in result.trace],
        "n_points": result.trace[-1].n_points,
        **{name: result.metrics["observable"][name] for name in metrics},
    }


def _fly(config, rock, replicate, directory, keep, sender) -> None:  # type: ignore[no-untyped-def]
    import resource

    # Other processes may share the cores: let every stage timer of the mission read the CPU clock.
    time.perf_counter = time.process_time
    from nbv.photogrammetric import run_photogrammetric_mission

    marks: list[float] = []

    def note(line) -> None:  # type: ignore[no-untyped-def]
        if line.startswith(("seed model", "capture")):
            marks.append(time.process_time())

    wall, cpu = time.monotonic(), time.process_time()
    result = run_photogrammetric_mission(config, rock, replicate, directory, keep=keep, log=note)
    wall, cpu = time.monotonic() - wall, time.process_time() - cpu
    peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024  # Linux counts in KiB
    captures = [after - before for before, after in itertools.pairwise(marks)]
    sender.send(MeasuredMission(result, wall, cpu, peak_mb, captures))
    sender.close()


def timed_mission(
    config: MissionConfig, rock: str, replicate: int, directory: Path, *, keep: str = "summary"
) -> MissionResult:
    """A mission function for the tuner's executors that adds ``cpu_s`` and ``peak_rss_mb`` to the costs."""
    import dataclasses
    import resource

    from nbv.photogrammetric import run_photogrammetric_mission

    started = time.process_time()
    result = run_photogrammetric_mission(config, rock, replicate)
    peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    costs = {**result.costs, "cpu_s": time.process_time() - started, "peak_rss_mb": peak_mb}
    return dataclasses.replace(result, costs=costs)


def forget_sequences(home: Path, between_words: str = "-") -> None:
    """Remove from the store what is kept of whole missions; photographs, features, pairs, seed models stay."""
    import shutil

    for kind in SEQUENCE_KINDS:
        shutil.rmtree(home / "store" / kind.replace("-", between_words), ignore_errors=True)
