"""A mission that takes no time, whose F-score saturates with its photographs: 98.2 with the paper's 24 + 8."""

import math
from pathlib import Path

import fake_missions

from nbv.config import MissionConfig
from nbv.mission.result import MissionResult
from nbv.plugins import register
from tuner.problem.space_files import load_search_space, space_from_dict

NOISE_SD = 0.25
SPACE = space_from_dict(  # what matters to them
    {
        "name": "photographs",
        "base": load_search_space("photographs").base,
        "parameters": {
            "seed.count": {"kind": "int", "low": 8, "high": 24, "default": 24},
            "stop.adaptive_budget": {"kind": "int", "low": 2, "high": 16, "default": 8},
            "pool.max_altitude_m": {"kind": "float", "low": 1.45, "high": 4.0, "default": 4.0},
        },
    },
    "photograph_missions.py",
)


def photographs(config: MissionConfig) -> int:
    """Seeds and planned views."""
    return config.seed.total + config.adaptive_budget


def truth(config: MissionConfig) -> float:
    """Mean F-score over the rocks; the least photographs that give 98 are 24, low above the ground."""
    views = config.seed.total + 1.5 * config.adaptive_budget
    height = (config.pool.max_altitude_m - 1.45) / 2.55
    return 100.0 - 22.0 * math.exp(-(views - 12.0) / 8.0) - 1.2 * (height - 0.25) ** 2


def mission(
    config: MissionConfig, rock: str, replicate: int, directory: Path | None, *, keep: str = "summary"
) -> MissionResult:
    """`truth`, a rock's shift and noise."""
    noise = NOISE_SD * float(fake_missions.draw("noise", rock, replicate, config.digest()).normal())
    shift = {"a": 0.3, "b": -0.3}.get(rock, 0.0)
    metrics = {"observable": {"f_score_48mm": truth(config) + shift + noise}}
    return fake_missions.well_flown(config, rock, replicate, metrics, float(photographs(config)))


register("fidelities", "saturating", mission)
