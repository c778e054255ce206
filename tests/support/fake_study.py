"""A mission function like ``run_study_mission`` with known variance components.

The outcome is mu + C + CR + R + B + e. C and CR are normal draws keyed by the configuration, so any
configuration has one. The signal doubles from a budget of 8 to 16 and fades with strictness below 5.
"""

from __future__ import annotations

import dataclasses
import hashlib
from pathlib import Path

import numpy as np
from fake_missions import note_flight, well_flown

from nbv.config import MissionConfig
from nbv.errors import MissionFailure
from nbv.mission.result import MissionResult

SD = {"configuration": 3.0, "configuration x rock": 1.0, "rock": 5.0, "replicate": 1.5, "residual": 1.0}


def draw(*key: object) -> float:
    digest = hashlib.sha256(repr(key).encode()).digest()
    return float(np.random.default_rng(int.from_bytes(digest[:8], "little")).normal())


def signal(budget: int, level: int) -> float:
    """Factor on C and CR."""
    return (budget / 8) * min(1.0, level / 5)


def identity(config: MissionConfig) -> tuple[object, ...]:
    """What tells configurations apart, whatever the budget."""
    return (config.gate.kind, config.gate.budget_fraction, config.gate.d95_m)


def fake_study_mission(
    config: MissionConfig, rock: str, replicate: int, directory: Path, *, keep: str = "summary"
) -> MissionResult:
    """A mission that takes no time."""
    if rock == "failing" and config.gate.kind == "random":
        raise MissionFailure("seed_model_failed", "no seed model")
    who, budget = identity(config), config.stop.adaptive_budget
    agreement = {}
    for level in (2, 3, 4, 5, 6):
        factor = signal(budget, level)
        y = (
            60.0
            + factor * SD["configuration"] * draw("C", who)
            + factor * SD["configuration x rock"] * draw("CR", who, rock)
            + SD["rock"] * draw("R", rock)
            + SD["replicate"] * draw("B", rock, replicate)
            + SD["residual"] * draw("e", who, rock, replicate, budget)
        )
        agreement[str(level)] = {"observable": {"f_score_48mm": y}, "whole": {"c2c_mean_mm": 100 - y}}
    note_flight(directory)
    result = well_flown(config, rock, replicate, {"agreement": agreement})
    return dataclasses.replace(result, timings_s={"agreement_levels": 2.0}, costs={"wall_s": 12.0 + budget})
