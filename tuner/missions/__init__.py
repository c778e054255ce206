"""How missions are flown for the tuner: runners by name, jobs and their outcomes, processes to fly them in."""

from tuner.missions.executors import Executor, InProcessExecutor, LocalProcessExecutor
from tuner.missions.job import MissionJob, MissionOutcome
from tuner.missions.registry import RUNNERS, resolve_runner

__all__ = [
    "RUNNERS",
    "Executor",
    "InProcessExecutor",
    "LocalProcessExecutor",
    "MissionJob",
    "MissionOutcome",
    "resolve_runner",
]
