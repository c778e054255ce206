"""What studies fly: photogrammetric missions, or geometric ones in a fraction of the time."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from nbv.config import MissionConfig
from nbv.errors import UserError
from nbv.geometric import run_geometric_mission
from nbv.mission.result import MissionResult
from tuner.missions.job import DEFAULT_RUNNER, Keep


def run_geometric_with_oracle(
    config: MissionConfig, rock: str, replicate: int, directory: Path, *, keep: Keep = "summary"
) -> MissionResult:
    """``run_geometric_mission`` that logs the oracle's rewards, as photogrammetric missions do."""
    return run_geometric_mission(config, rock, replicate, directory, keep=keep, shadow=True)


RUNNERS = {
    "photogrammetric": DEFAULT_RUNNER,
    "geometric": "tuner.missions.fidelities:run_geometric_with_oracle",
}
GEOMETRIC_NOTE = (
    "Geometric missions: the same loop, scorers, gates and flight over simulated tracks, no photographs. Completeness is "
    "predicted, accuracy is taken as 100 %, distances are absent, and features, matching and the ground-truth gate have "
    "nothing to act on."
)


def runner_of(fidelity: str, runners: Mapping[str, str] = RUNNERS) -> str:
    """The mission runner of a fidelity; ``UserError`` if there is none."""
    if fidelity not in runners:
        raise UserError(f"unknown fidelity {fidelity!r}; choose from {', '.join(runners)}")
    return runners[fidelity]
