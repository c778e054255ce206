"""What pages read of a mission's run directory."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from nbv.cache import Store
from nbv.config import MissionConfig, config_from_dict
from nbv.errors import UserError
from nbv.mission.planning_state import load_state
from nbv.mission.result import IterationRecord, MissionResult
from nbv.mission.run_directory import CONFIG, FLIGHT, LOCATED, state_files
from nbv.rocks import Rock
from nbv.safe_files import RESULT_BYTES, read_json, read_yaml
from nbv.types import CandidatePool, Floats, PlanningState
from tuner.missions.registry import mission_kind


@dataclass(frozen=True)
class Flight:
    samples: Floats  # (N, 4): time in s; east, north and up in m
    ends_s: dict[str, float]  # by event, such as ``seed_03``, ``cand_017`` and ``return``, in their order
    duration_s: float

    def photographed_m(self) -> dict[str, Floats]:
        """(3,) by viewpoint's name: where the vehicle was when it photographed there, in the order flown."""
        last = len(self.samples) - 1
        return {
            name: self.samples[min(int(np.searchsorted(self.samples[:, 0], end_s)), last), 1:]
            for name, end_s in self.ends_s.items()
            if name.startswith(("seed_", "cand_"))
        }


def mission_config(run: Path) -> MissionConfig:
    """The configuration of a mission's directory; ``UserError`` if it is not there."""
    file = run / CONFIG
    if not file.is_file():
        raise UserError(f"{run} holds no {CONFIG}; name a directory that `gatetune mission run` wrote")
    return config_from_dict(read_yaml(file))


def planned_config(run: Path) -> MissionConfig:
    """The configuration that the mission planned with: with the target as the vehicle knew it."""
    return config_from_dict(read_yaml(run / LOCATED)) if (run / LOCATED).is_file() else mission_config(run)


def read_flight(run: Path) -> Flight:
    """The flight of a mission; ``UserError`` if the mission kept nothing of it."""
    file = run / FLIGHT
    if not file.is_file():
        raise UserError(
            f"{run} holds no flight; name a mission that was run with all files kept (gatetune mission run, or --keep all)"
        )
    tree = read_json(file, RESULT_BYTES)
    try:
        samples = np.array([row[:4] for row in tree["samples"]], dtype=float).reshape(-1, 4)
        events = [(str(e["name"]), float(e["start_s"]), float(e["duration_s"])) for e in tree["events"]]
        ends = {name: start_s + duration_s for name, start_s, duration_s in events}
        return Flight(samples, ends, float(tree["flight_time_s"]))
    except (KeyError, TypeError, ValueError, IndexError) as error:
        raise UserError(f"{file} is not a mission's flight; restore it") from error


def planning_steps(
    run: Path, result: MissionResult
) -> list[tuple[PlanningState, CandidatePool, IterationRecord]]:
    """The planner's state, its candidates and what it decided, for every planned view."""
    return [(*load_state(path), record) for path, record in zip(state_files(run), result.trace)]


def rock_of_mission(run: Path, result: MissionResult, rock: str | None, store: Store) -> Rock:
    """The rock that the mission in ``run`` was run on; ``UserError`` if the one found is another.

    ``rock``: catalogue name or mesh file, for a rock that is not in the catalogue under the mission's name for it.
    """
    name, remedy = rock or result.rock, "name its mesh file with --rock"
    try:
        loaded = mission_kind(result.provenance.get("fidelity", "")).load_rock(name, store)
    except UserError as error:
        if rock is not None:
            raise
        raise UserError(f"{run} was run on {name!r}, which the catalogue does not have; {remedy}") from error
    if loaded.sha256 != result.provenance.get("rock_sha256", loaded.sha256):
        raise UserError(f"{run} was run on another {name!r} than the one found now; {remedy}")
    return loaded


def thin_indices(total: int, count: int) -> np.ndarray:
    """At most ``count`` indices of ``range(total)``: a fixed random choice, in order."""
    if total <= count:
        return np.arange(total)
    return np.sort(np.random.default_rng(0).permutation(total)[:count])
