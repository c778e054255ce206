"""One mission in a process of its own, timed from inside: what the speed benchmarks share."""

from __future__ import annotations

import multiprocessing
import os
import time
from dataclasses import dataclass
from pathlib import Path

from nbv.config import MissionConfig
from nbv.result import MissionResult
from nbv.threads import single_thread_environment

# What nbv.cached_stages keeps of whole missions; the rest of the store is parts that missions share.
SEQUENCE_KINDS = ("sequence_models", "clouds", "evaluations")


@dataclass(frozen=True)
class Flown:
    """A mission and what it cost. Imports come before the clock: a campaign's workers fork with them."""

    result: MissionResult
    wall_s: float
    cpu_s: float
    peak_rss_mb: float


def fly_in_fresh_process(
    config: MissionConfig, rock: str, replicate: int, home: Path, directory: Path | None = None
) -> Flown:
    """Fly with the rocks, caches and store of ``home``, on one thread."""
    single_thread_environment()  # inherited by the child, before it imports anything
    os.environ["GATETUNE_HOME"] = str(home)
    context = multiprocessing.get_context("spawn")
    receiver, sender = context.Pipe(duplex=False)
    child = context.Process(target=_fly, args=(config, rock, replicate, directory, sender))
    child.start()
    sender.close()
    try:
        flown: Flown = receiver.recv()
    finally:
        child.join()
    return flown


def _fly(config, rock, replicate, directory, sender) -> None:  # type: ignore[no-untyped-def]
    import resource

    import nbv.evaluation
    import nbv.photogrammetric
    import nbv.scene  # noqa: F401
    from nbv.mission import run_mission

    wall, cpu = time.perf_counter(), time.process_time()
    result = run_mission(config, rock, replicate, directory, keep="summary")
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024  # Linux counts in KiB
    sender.send(Flown(result, wall, cpu, peak_mb))
    sender.close()


def forget_sequences(home: Path) -> None:
    """Remove from the store what is kept of whole missions; photographs, features, pairs, seed models stay."""
    import shutil

    for kind in SEQUENCE_KINDS:
        shutil.rmtree(home / "store" / kind, ignore_errors=True)
