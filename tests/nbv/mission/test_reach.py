"""From what flies, plans and reconstructs no way leads to a true pose or to the true surface."""

import functools
import gc
import types
from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np
import pytest

from nbv.config import preset
from nbv.flight.telemetry import TelemetryErrors
from nbv.gates import GroundTruthOracle
from nbv.mission import fidelity
from nbv.mission.loop import AdaptiveMission
from nbv.photogrammetric import run_photogrammetric_mission
from nbv.photogrammetric.simulated_camera import SimulatedCamera
from nbv.rocks import Rock

TRUTH = (Rock, TelemetryErrors, GroundTruthOracle, SimulatedCamera)
# Black photographs do not register: the mission ends with its seeds, after everything has been handed out.
SMALL = {"camera.width_px": 64, "camera.height_px": 48, "camera.focal_px": 46.0, "photographs": 25}


def neighbours(thing: Any) -> Iterable[Any]:
    """What can be had from ``thing``: not the modules, classes and globals that everything hangs on."""
    if isinstance(thing, types.FunctionType):
        return [c.cell_contents for c in thing.__closure__ or () if c != types.CellType()]
    if isinstance(thing, types.MethodType):
        return [thing.__self__, thing.__func__]
    if isinstance(thing, functools.partial):
        return [thing.func, *thing.args, *thing.keywords.values()]
    if isinstance(thing, (type, types.ModuleType, types.BuiltinFunctionType, types.FrameType, str, bytes)):
        return []
    return gc.get_referents(thing)


def reachable(*roots: Any) -> Iterator[Any]:
    """Everything that can be reached from ``roots``, each once."""
    seen: dict[int, Any] = {}
    waiting = list(roots)
    while waiting:
        thing = waiting.pop()
        if id(thing) in seen:
            continue
        seen[id(thing)] = thing
        yield thing
        waiting.extend(neighbours(thing))


@pytest.fixture(scope="module")
def evaluated() -> Iterator[tuple[AdaptiveMission, list[np.ndarray], np.ndarray]]:
    """A mission that has taken its seeds, the true poses of these, and the rock's vertices."""
    missions: list[AdaptiveMission] = []
    true_poses: list[np.ndarray] = []
    rocks: list[Rock] = []

    class Kept(AdaptiveMission):
        def __init__(self, *arguments: Any) -> None:
            super().__init__(*arguments)
            missions.append(self)

    true_pose, made = TelemetryErrors.true_pose, SimulatedCamera.__init__

    def noting(self: TelemetryErrors, *arguments: Any) -> Any:
        true_poses.append(true_pose(self, *arguments))
        return true_poses[-1]

    def making(self: SimulatedCamera, make_renderer: Any, rock: Rock, *rest: Any) -> None:
        rocks.append(rock)
        made(self, make_renderer, rock, *rest)

    config = preset("campaign").with_values({**SMALL, "telemetry": "gnss", "target.horizontal_sd_m": 0.5})
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(fidelity, "AdaptiveMission", Kept)
        patch.setattr(TelemetryErrors, "true_pose", noting)
        patch.setattr(SimulatedCamera, "__init__", making)
        patch.setattr(SimulatedCamera, "photograph", lambda *_: np.zeros((48, 64, 3), np.uint8))
        result = run_photogrammetric_mission(config, "boulder", 0)
    assert result.reason == "seed_model_failed"
    yield missions[0], true_poses, rocks[0].vertices_m


@pytest.mark.slow
def test_no_true_pose_and_no_surface_can_be_reached(evaluated) -> None:  # type: ignore[no-untyped-def]
    mission, true_poses, vertices_m = evaluated
    assert len(mission.captures) == len(true_poses) == 24
    vehicle = (mission.config, mission.flight, mission.planner.gate, mission.reconstructor, mission.captures)
    for thing in reachable(*vehicle):
        assert not isinstance(thing, TRUTH), type(thing)
        if isinstance(thing, np.ndarray) and thing.shape == (4, 4):
            assert not any(np.array_equal(thing, pose) for pose in true_poses)
        if isinstance(thing, np.ndarray) and thing.shape == vertices_m.shape:
            assert not np.array_equal(thing, vertices_m)


@pytest.mark.slow
def test_the_walk_would_have_found_them(evaluated) -> None:  # type: ignore[no-untyped-def]
    mission, _, vertices_m = evaluated
    things = list(reachable(mission.camera))
    for kind in (Rock, TelemetryErrors, SimulatedCamera):
        assert any(isinstance(thing, kind) for thing in things)
    assert any(thing is vertices_m for thing in things)
    assert any(isinstance(thing, Rock) for thing in reachable(lambda: mission.camera))
