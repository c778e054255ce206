"""What a call of a plug-in takes beside its own work: a scorer in this process, and a planner in another.

    python -m research.plugin_calls

Flies a geometric mission of 12 + 36 photographs with each. The scorer notes its own time; the program answers without a look at
what it has read, so that all of its time counts. Medians over the decisions in milliseconds: wall time, which other load on the machine
adds to, and processor time of this process.
"""

from __future__ import annotations

import shlex
import sys
import time
from typing import Any

import numpy as np

from nbv import plugins
from nbv.config import Weights, preset
from nbv.gates.external import ExternalGate
from nbv.geometric import run_geometric_mission
from nbv.scorers import Scorer
from tuner.comparison.curves import BASE

PROGRAM = """
import sys
for line in sys.stdin:
    print('{"view": "' + line.split('"ids":["')[1].split('"')[0] + '"}', flush=True)
"""


Times = list[tuple[float, float]]  # wall and processor time of each call, in seconds


def timed(function: Any, times: Times) -> Any:
    def call(*arguments: Any) -> Any:
        wall_s, cpu_s = time.perf_counter(), time.process_time()
        try:
            return function(*arguments)
        finally:
            times.append((time.perf_counter() - wall_s, time.process_time() - cpu_s))

    return call


def run(kind: str) -> None:
    values = {**BASE, "gate.kind": kind, "stop.adaptive_budget": 36, "seed.count": 12}
    mission = run_geometric_mission(preset("campaign").with_values(values), "slab")
    assert mission.status != "failed", mission.message


def tell(what: str, times: Any) -> None:
    wall_ms, cpu_ms = 1000.0 * np.median(times, axis=0)
    print(f"{what}: {wall_ms:.2f} ms, {cpu_ms:.2f} ms of this processor, {len(times)} calls")


def main() -> None:
    own: Times = []
    whole: Times = []
    low = Scorer("low", timed(lambda terms, pool, config: np.zeros(len(pool)), own), lambda config: Weights())
    plugins.register("scorers", "low", low)
    loaded = plugins.plugins("scorers")["low"].loaded
    object.__setattr__(loaded, "main_term", timed(loaded.main_term, whole))
    run("low")
    tell("scorer, beside its own work", np.subtract(whole, own))
    plugins.use(f"echo={sys.executable} -c {shlex.quote(PROGRAM)}")
    times: Times = []
    decide = ExternalGate.decide
    ExternalGate.decide = lambda self, *rest: timed(decide, times)(self, *rest)  # type: ignore[method-assign]
    run("echo")
    tell("program, first call, which starts it", times[:1])
    tell("program, later calls", times[1:])


if __name__ == "__main__":
    main()
