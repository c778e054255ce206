"""How missions are flown for the tuner: fidelities by name, jobs and their outcomes, processes to fly them in."""

from tuner.missions.executors import Executor, InProcessExecutor, LocalProcessExecutor
from tuner.missions.job import MissionJob, MissionOutcome
from tuner.missions.registry import FIDELITIES, mission_function

__all__ = [
    "FIDELITIES",
    "Executor",
    "InProcessExecutor",
    "LocalProcessExecutor",
    "MissionJob",
    "MissionOutcome",
    "mission_function",
]
