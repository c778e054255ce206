"""How missions are flown for the tuner: fidelities by name, jobs and their trials, processes to fly them in."""

from tuner.missions.executors import Executor, InProcessExecutor, LocalProcessExecutor
from tuner.missions.job import MissionJob, Trial
from tuner.missions.registry import FIDELITIES, mission_function

__all__ = [
    "FIDELITIES",
    "Executor",
    "InProcessExecutor",
    "LocalProcessExecutor",
    "MissionJob",
    "Trial",
    "mission_function",
]
