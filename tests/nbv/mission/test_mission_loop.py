"""The loop of Fig. 1 on its own: a reconstructor that only counts, real flight, real planning."""

import numpy as np
import pytest

from nbv.config import preset
from nbv.errors import MissionFailure
from nbv.flight import Flight
from nbv.gates import make_gate
from nbv.geometric.geometric_fidelity import PoseCamera
from nbv.geometry.frames import camera_centers_m
from nbv.mission.loop import AdaptiveMission
from nbv.mission.recorder import Recorder
from nbv.process import Stopwatch
from nbv.types import PointCloud, SparseModel, UpdateReport


class CountingReconstructor:
    """A ball of points around the target; every capture adds some; chosen captures do not register."""

    def __init__(self, refuse=(), points=400):
        self.refuse, self.points = set(refuse), points
        self.names, self.centers, self.adds = [], [], 0

    def _model(self):
        rng = np.random.default_rng(0)
        n = self.points + 50 * self.adds
        points = rng.normal(size=(n, 3))
        points = [0, 0, 0.8] + 0.7 * points / np.linalg.norm(points, axis=1, keepdims=True)
        cameras = np.stack([rng.permutation(min(24, len(self.centers)))[:3] for _ in range(n)])
        return SparseModel(
            points,
            np.full(n, 0.5),
            np.arange(n + 1) * 3,
            cameras.ravel(),
            np.array(self.centers),
            tuple(self.names),
            0.005,
            0.01,
        )

    def bootstrap(self, captures):
        for capture in captures:
            self._take(capture)
        return UpdateReport(self._model(), True)

    def partial_model(self, captures):
        self.partial_captures = [capture.name for capture in captures]
        self.centers = [camera_centers_m(capture.camera_from_world) for capture in captures]
        model, self.centers = self._model(), []
        return model

    def add(self, capture):
        self.adds += 1
        registered = self.adds not in self.refuse
        if registered:
            self._take(capture)
        return UpdateReport(self._model(), registered, "" if registered else "too few matches")

    def recentre(self, target_m, half_width_m):
        self.recentred = (target_m, half_width_m)

    def finish(self):
        return PointCloud(np.zeros((1, 3)))

    def _take(self, capture):
        self.names.append(capture.name)
        self.centers.append(camera_centers_m(capture.camera_from_world))


def made(config, reconstructor=None, flight=None):
    flight = flight or Flight(config, rock_sha256="rock", replicate=0)
    return AdaptiveMission(
        config,
        flight,
        PoseCamera(config.target_m),
        reconstructor or CountingReconstructor(),
        make_gate(config),
        Recorder(config, Stopwatch()),
    )


def run_loop(reconstructor=None, **values):
    config = preset("campaign").with_values({"photographs": 28, **values})
    mission = made(config, reconstructor)
    mission.run()
    mission.trace, mission.notes = mission.recorder.trace, mission.recorder.notes
    return mission


class NoSeedModel(CountingReconstructor):
    def bootstrap(self, captures):
        raise MissionFailure("seed_model_failed", "too few")


def test_a_mission_without_a_seed_model_fails():
    """Views that are left to plan do not help."""
    with pytest.raises(MissionFailure, match="too few"):
        run_loop(NoSeedModel())


def test_an_unregistered_image_counts_and_the_mission_goes_on():
    mission = run_loop(CountingReconstructor(refuse={2}))
    assert [record.registered for record in mission.trace] == [True, False, True, True]
    assert mission.trace[1].message == "too few matches"
    assert len(mission.captures) == 24 + 4
    assert mission.notes == ["unregistered_image"]


def test_convergence_is_looked_for_before_every_capture():
    d95 = [record.d95_m for record in run_loop().trace]
    assert d95 == sorted(d95, reverse=True)  # the ball fills up
    threshold = (d95[1] + d95[2]) / 2
    mission = run_loop(**{"stop.criterion": "both", "stop.knn_threshold_m": threshold})
    assert len(mission.trace) == 2


def test_an_empty_pool_ends_the_adaptive_phase_and_says_so():
    mission = run_loop(**{"pool.max_travel_m": 0.1})
    assert mission.trace == []
    assert mission.notes == ["empty_pool"]


def test_no_second_counts_for_two_stages(monkeypatch):
    clock = iter([0.0, 1.0, 4.0, 10.0])
    monkeypatch.setattr("nbv.process.time.perf_counter", lambda: next(clock))
    watch = Stopwatch()
    with watch.timed("photograph"), watch.timed("scene"):
        pass
    assert watch.total_s == {"photograph": 7.0, "scene": 3.0}
