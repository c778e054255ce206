"""What studies fly: photogrammetric missions, or geometric ones in a fraction of the time."""

from __future__ import annotations

from collections.abc import Mapping

from nbv.errors import UserError
from tuner.missions.job import DEFAULT_RUNNER

RUNNERS = {
    "photogrammetric": DEFAULT_RUNNER,
    "geometric": "nbv.geometric:run_geometric_mission_with_oracle",
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
