"""The mission of `make faults`: it takes a tenth of a second, or FAULTS_SECONDS, and says in a file of its own what it did.

One line per event, appended in one write to the file FAULTS_RECORD, which lies outside the run directory: ``began``, ``ending``
just before ``mission.json`` is there, ``ended`` just after; ``untrue`` where the store gave it something else than was put
there. The campaign never sees that file.
"""

from __future__ import annotations

import os
import random
import time
from pathlib import Path

import numpy as np

from nbv.cache import Store, cached_json
from nbv.config import MissionConfig
from nbv.mission.result import MissionResult
from nbv.mission.run_directory import write_atomic
from nbv.plugins import register

NEEDS = 2**22  # numbers, 32 MiB: where a limit on memory bites


def run_missions(
    config: MissionConfig, rock: str, replicate: int, directory: Path, *, keep: str = "summary"
) -> MissionResult:
    """A mission that never fails of itself; its score is drawn from what it is."""
    score = random.Random(f"{rock} {replicate} {config.digest()}").random()
    what = f"{directory.name} {score!r}"
    record("began", what)
    filled = np.ones(NEEDS)
    kept = cached_json(
        Store(), "faults", lambda: _kept(rock, replicate), code="nbv.cache", inputs=(rock, replicate)
    )
    if kept != _kept(rock, replicate):
        record("untrue", what)
    time.sleep(float(os.environ.get("FAULTS_SECONDS") or random.uniform(0.02, 0.15)))
    with (directory / "cloud.bin").open("wb") as file:
        file.write(filled[:1024].tobytes())
    result = MissionResult(
        status="ok",
        reason="",
        message="",
        condition=config.condition,
        config_digest=config.digest(),
        rock=rock,
        replicate=replicate,
        metrics={"observable": {"f_score_48mm": score}},
        trace=[],
        timings_s={"flight": 0.1},
        costs={"images": 32.0, "flight_time_s": 100.0, "path_length_m": 50.0, "wall_s": 0.1},
    )
    record("ending", what)
    write_atomic(directory / "mission.json", result.to_json())
    record("ended", what)
    time.sleep(random.uniform(0, 0.02))
    return result


def _kept(rock: str, replicate: int) -> list[float]:
    """What a mission has from the store: some kilobytes."""
    draws = random.Random(f"{rock} {replicate}")
    return [draws.random() for _ in range(500)]


def record(event: str, what: str) -> None:
    """One whole line, whoever else writes."""
    descriptor = os.open(os.environ["FAULTS_RECORD"], os.O_WRONLY | os.O_APPEND | os.O_CREAT)
    os.write(descriptor, f"{event} {what} {time.time()}\n".encode())
    os.close(descriptor)


register("fidelities", "faults", run_missions)
