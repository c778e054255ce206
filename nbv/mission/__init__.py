"""The closed loop of the paper's Fig. 1, its result and its run directory.

``loop`` is the loop; ``flying`` surrounds it with what missions of every fidelity share; ``recorder`` watches it.
"""

from nbv.mission.function import MissionFunction, MissionOptions
from nbv.mission.result import IterationRecord, MissionResult
from nbv.mission.run_directory import RunDirectory

__all__ = ["IterationRecord", "MissionFunction", "MissionOptions", "MissionResult", "RunDirectory"]
