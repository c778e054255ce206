"""The camera of a mission over a set: a photograph that exists stands for each that the mission takes."""

from __future__ import annotations

from nbv.flight.telemetry import TelemetryErrors
from nbv.mission.fidelity import MissionContext
from nbv.photographs.photograph_set import PhotographSet
from nbv.photographs.viewpoints import PhotographViewpoints
from nbv.types import Camera, Capture, Floats, Viewpoint

_NO_GROUND_M = -1e6  # a set has no ground that a camera must stay above


class PhotographCamera(Camera):
    """Returns the set's photograph at each of its ``viewpoints``, and the reference's pose with the errors of ``telemetry``."""

    def __init__(
        self, context: MissionContext, photographs: PhotographSet, viewpoints: PhotographViewpoints
    ) -> None:
        super().__init__(photographs.target_m)
        self._set, self._viewpoints = photographs, viewpoints
        telemetry, key = context.config.telemetry, context.rock.sha256
        self._errors = TelemetryErrors(telemetry, key, context.replicate, _NO_GROUND_M)
        self.taken: list[str] = []  # names, in order

    def take_photograph(self, viewpoint: Viewpoint, position_m: Floats, time_s: float) -> Capture:
        photograph = self._set.registered[self._viewpoints.index(viewpoint)]
        assert photograph.camera_from_world is not None
        reported = self._errors.true_pose(photograph.camera_from_world, viewpoint.id, time_s)
        self.taken.append(photograph.name)
        return Capture(f"{viewpoint.id}.png", viewpoint, reported, self._set.image(photograph.name))
