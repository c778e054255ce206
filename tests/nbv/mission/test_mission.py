"""One small end-to-end photogrammetric mission, what its run directory promises, and that no way leads to the truth."""

import functools
import gc
import json
import types
from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np
import pytest
from scene_helpers import SMALL_GROUND

from nbv.config import config_from_dict, preset
from nbv.flight.telemetry import TelemetryErrors
from nbv.gates import GroundTruthOracle
from nbv.geometry.ply import read_ply
from nbv.mission import fidelity
from nbv.mission.loop import AdaptiveMission
from nbv.mission.result import MissionResult
from nbv.photogrammetric import run_photogrammetric_mission
from nbv.photogrammetric.simulated_camera import SimulatedCamera
from nbv.rocks import Rock
from nbv.rocks.catalogue import LOADED

ROCK = "boulder"
SEEDS, BUDGET = 16, 2


@pytest.fixture(scope="module")
def config():
    return preset("campaign").with_values(
        {
            "photographs": SEEDS + BUDGET,
            "seeds": SEEDS,
            "seed.layout": "turn",
            "evaluation.gt_samples": 10_000,
            "dense.agreeing_views": 3,
            "dense.max_size_px": 320,
        }
    )


@pytest.fixture(scope="module", autouse=True)
def small_ground(tmp_path_factory):
    """And a home of its own, so that no other test meets these photographs."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("GATETUNE_HOME", str(tmp_path_factory.mktemp("home")))
        patch.setattr("nbv.scene.bake.GroundSpec", lambda: SMALL_GROUND)
        yield


@pytest.fixture(scope="module")
def finished(config, tmp_path_factory):
    directory = tmp_path_factory.mktemp("mission") / "run"
    lines = []
    result = run_photogrammetric_mission(config, ROCK, 0, directory, log=lines.append)
    return result, directory, lines


@pytest.mark.slow
def test_the_mission_reconstructs_the_rock(finished):
    result, _, lines = finished
    assert (result.status, result.reason) == ("ok", "")
    assert result.costs["images"] == result.costs["registered_images"] == SEEDS + BUDGET
    assert result.metric("observable.completeness_48mm") > 80
    assert result.metric("whole.c2c_median_mm") < 20
    assert result.metric("observable.accuracy_48mm") > 90
    assert lines[0].startswith("seed model")
    assert [line.split()[0] for line in lines[1:]] == ["capture"] * BUDGET


@pytest.mark.slow
def test_the_run_directory_holds_what_it_promises(finished, config):
    import pycolmap
    import yaml

    result, directory, _ = finished
    assert MissionResult.load(directory).to_json() == result.to_json()
    assert config_from_dict(yaml.safe_load((directory / "config.yaml").read_text())) == config
    assert len(list((directory / "images").glob("*.png"))) == SEEDS + BUDGET
    trace = [json.loads(line) for line in (directory / "trace.jsonl").read_text().splitlines()]
    assert [record["chosen"] for record in trace] == [record.chosen for record in result.trace]
    assert result.provenance["rock_sha256"]
    assert result.provenance["versions"]["pycolmap"]

    # The exported model opens in COLMAP and is in the world frame: cameras stand on the 4 m and 3.5 m spheres.
    model = pycolmap.Reconstruction(directory / "sparse" / "0")
    assert model.num_reg_images() == SEEDS + BUDGET
    for image in model.images.values():
        radius = np.linalg.norm(image.projection_center() - np.array([0, 0, 0.8]))
        expected = 4.0 if image.name.startswith("seed") else 3.5
        assert abs(radius - expected) < 0.35 * np.sqrt(3)

    dense, cleaned = (read_ply(directory / name)[0] for name in ("dense.ply", "cleaned.ply"))
    assert len(dense.points_m) > len(cleaned.points_m) > 1000
    assert abs(cleaned.points_m[:, 2].max() - 1.6) < 0.05  # the rock's height


@pytest.mark.slow
def test_cached_and_uncached_missions_are_bit_identical(finished, config, tmp_path, monkeypatch):
    result, directory, _ = finished  # filled the store
    again = run_photogrammetric_mission(config, ROCK, 0, tmp_path / "cached", cache=True)
    monkeypatch.setenv("GATETUNE_HOME", str(tmp_path / "home"))
    LOADED.clear()
    without = run_photogrammetric_mission(config, ROCK, 0, tmp_path / "uncached", cache=False)
    assert not (tmp_path / "home").exists()  # nothing was read or written
    for other in ("cached", "uncached"):
        assert (tmp_path / other / "dense.ply").read_bytes() == (directory / "dense.ply").read_bytes()
        assert (tmp_path / other / "sparse/0/points3D.bin").read_bytes() == (
            directory / "sparse/0/points3D.bin"
        ).read_bytes()
    assert again.metrics == without.metrics == result.metrics


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
