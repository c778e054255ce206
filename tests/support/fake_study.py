"""A mission function with known variance components.

The outcome is mu + C + CR + R + B + e: normal draws keyed by the configuration, so any configuration has one.
"""

from __future__ import annotations

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


def fake_study_mission(
    config: MissionConfig, rock: str, replicate: int, directory: Path, *, keep: str = "summary"
) -> MissionResult:
    """A mission that takes no time; one that fails where the first threshold is high on a rock called failing."""
    who = (config.gate.budget_fraction, config.gate.d95_m)
    if rock == "failing" and config.gate.budget_fraction > 0.8:
        raise MissionFailure("seed_model_failed", "no seed model")
    y = (
        60.0
        + SD["configuration"] * draw("C", who)
        + SD["configuration x rock"] * draw("CR", who, rock)
        + SD["rock"] * draw("R", rock)
        + SD["replicate"] * draw("B", rock, replicate)
        + SD["residual"] * draw("e", who, rock, replicate)
    )
    note_flight(directory)
    return well_flown(
        config, rock, replicate, {"observable": {"f_score_48mm": y}, "whole": {"c2c_mean_mm": 100 - y}}
    )
