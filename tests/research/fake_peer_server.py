"""A trivial peer for tests, in a process of its own: random points, or an accident named on the command line.

It answers from what it was told alone, so that a test can see what that was: in the first parameter, the share of
the missions it knows among 100; seeds make the others.
"""

from __future__ import annotations

import os
import random
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "research" / "peers"))

from serving import Ask, Trial, serve

ACCIDENT = sys.argv[1] if len(sys.argv) > 1 else ""


class FakePeer:
    """Counts."""

    def __init__(self, start: Mapping[str, Any]) -> None:
        self.parameters = start["parameters"]
        self.rocks = start["rocks"]
        self.trials: list[Trial] = []
        print("a library that prints to standard output")

    def tell(self, trial: Trial) -> None:
        self.trials.append(trial)

    def ask(self, request: Ask) -> dict[str, Any]:
        if ACCIDENT == "die":
            print("the last words", file=sys.stderr, flush=True)
            os._exit(3)
        if ACCIDENT == "hang":
            time.sleep(60)
        if ACCIDENT == "raise":
            raise ValueError("a matrix is singular")
        rng = random.Random(request.seed)
        values = {p["name"]: self._draw(p, rng) for p in self.parameters}
        first = self.parameters[0]
        known = len(self.trials) / 100
        values[first["name"]] = first["low"] + known * (first["high"] - first["low"])
        if ACCIDENT == "outside":
            values[first["name"]] = "nowhere"
        standard = [z for t in self.trials if (z := request.standardise(t)) is not None]
        # As SMAC does: the peer chooses the rock. The mean shows that the scales came with the request.
        return {
            "values": values,
            "rock": self.rocks[-1],
            "replicate": 7,
            "mean": sum(standard) / len(standard),
        }

    @staticmethod
    def _draw(p: dict[str, Any], rng: random.Random) -> Any:
        if p["kind"] == "categorical":
            return rng.choice(p["choices"])
        value = rng.uniform(p["low"], p["high"])
        return round(value) if p["kind"] == "int" else value


if __name__ == "__main__":
    serve("fake", "1.0", FakePeer)
