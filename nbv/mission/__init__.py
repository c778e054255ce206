"""The closed loop of the paper's Fig. 1, its result and its run directory.

``loop`` is the loop; ``fidelity`` surrounds it with what missions of every fidelity share; ``recorder`` watches it.
"""

from nbv.mission.result import MissionFunction, MissionResult

__all__ = ["MissionFunction", "MissionResult"]
