"""The closed loop of the paper's Fig. 1, its result and its run directory.

``loop`` is the loop; ``fidelity`` surrounds it with what missions of every fidelity share; ``recorder`` watches it.
"""

from nbv.mission.function import MissionFunction
from nbv.mission.result import MissionResult

__all__ = ["MissionFunction", "MissionResult"]
