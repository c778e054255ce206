"""The figures of one mission, and why a candidate won."""

from tuner.report.mission.explain import explain_state
from tuner.report.mission.figures import write_mission_figures

__all__ = ["explain_state", "write_mission_figures"]
