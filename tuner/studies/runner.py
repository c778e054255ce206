"""The mission that the noise study flies: one flight, measured at several fusion strictness levels.

Different adaptive budgets are different missions and are not shared: Eq. 9 reads the share of the budget used,
so a mission of 16 captures does not begin with the mission of 8; and where it does (fixed scorers, controls)
the depth maps still change, because later views become their neighbours. Photographs, features, pairs and seed
models that missions have in common come from the store.
"""

from __future__ import annotations

from pathlib import Path

from nbv.config import MissionConfig
from nbv.mission.loop import run_mission
from nbv.mission.result import MissionResult
from tuner.missions.job import Keep

# Values of dense.agreeing_views that are measured; a mission is flown with the lowest.
AGREEMENT_LEVELS = (3, 5, 6, 7)
STUDY_RUNNER = "tuner.studies.runner:run_study_mission"


def run_study_mission(
    config: MissionConfig, rock: str, replicate: int, directory: Path, *, keep: Keep = "summary"
) -> MissionResult:
    """``run_mission``, with scores at all ``AGREEMENT_LEVELS`` from ``config.dense.agreeing_views`` on.

    They are in ``metrics["agreement"]["5"]["observable"]`` and so on.
    """
    levels = [level for level in AGREEMENT_LEVELS if level >= config.dense.agreeing_views]
    return run_mission(config, rock, replicate, directory, keep=keep, agreement_levels=levels)
