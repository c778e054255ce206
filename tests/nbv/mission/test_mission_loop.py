"""The loop of Fig. 1 on its own, with a target that is known or only roughly known."""

import numpy as np
import pytest

from nbv.config import MissionConfig, preset
from nbv.flight import Flight
from nbv.gates import make_gate
from nbv.geometric.geometric_fidelity import PoseCamera
from nbv.geometry.frames import camera_centers_m
from nbv.mission.loop import AdaptiveMission
from nbv.mission.recorder import Recorder
from nbv.mission.target_prior import with_target_error, with_target_found
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


def test_an_unregistered_image_counts_and_the_mission_goes_on():
    mission = run_loop(CountingReconstructor(refuse={2}))
    assert [record.registered for record in mission.trace] == [True, False, True, True]
    assert mission.trace[1].message == "too few matches"
    assert len(mission.captures) == 24 + 4
    assert mission.notes == ["unregistered_image"]


ROUGH = {"target.horizontal_sd_m": 0.5, "target.vertical_sd_m": 0.25, "photographs": 26}


class OnTheGround(CountingReconstructor):
    """The ball of `CountingReconstructor`, 0.7 m in radius, half a metre east, on a ground with points."""

    def __init__(self, ground_m: float = 0.0) -> None:
        super().__init__(points=6000)
        self.ground_m = ground_m

    def _model(self) -> SparseModel:
        model = super()._model()
        n = len(model.points_m) // 2
        points = model.points_m + np.array([0.5, 0.0, 0.0])
        ground = np.random.default_rng(1).uniform([-4, -4, 0], [4, 4, 0.02], (n, 3))
        points[:n] = ground
        points[:, 2] += self.ground_m
        return SparseModel(points, *(getattr(model, name) for name in list(vars(model))[1:]))


def test_belief_is_off_by_what_is_configured() -> None:
    config = MissionConfig().with_values(ROUGH)
    off_m = np.array([with_target_error(config, "rock", k).target_m for k in range(3000)]) - config.target_m
    np.testing.assert_allclose(off_m.std(axis=0), [0.5, 0.5, 0.25], rtol=0.06)
    np.testing.assert_allclose(off_m.mean(axis=0), 0.0, atol=0.04)
    assert (
        with_target_error(config, "rock", 1)
        == with_target_error(config, "rock", 1)
        != with_target_error(config, "rock", 2)
    )


def test_the_mission_goes_on_with_what_the_model_shows() -> None:
    config = with_target_error(preset("campaign").with_values(ROUGH), "rock", 3)
    mission = made(config, reconstructor := OnTheGround(), Flight(config, "rock", 3))
    mission.run()
    np.testing.assert_allclose(mission.config.target_m, [0.5, 0.0, 0.75], atol=0.1)
    # The crop is no less than configured, although the target is smaller.
    assert mission.config.dense.crop_half_width_m == config.dense.crop_half_width_m
    assert reconstructor.recentred == (mission.config.target_m, mission.config.dense.crop_half_width_m)
    for capture in mission.captures[24:]:  # 3.5 m from where the target was found, and aimed at it
        delta_m = np.array(mission.config.target_m) - capture.viewpoint.position_m
        assert np.linalg.norm(delta_m) == pytest.approx(3.5)
        aim = np.array(mission.config.target_m) - camera_centers_m(capture.camera_from_world)
        assert capture.camera_from_world[2, :3] @ aim == pytest.approx(np.linalg.norm(aim))
    assert mission.recorder.notes == []


def test_seeds_fly_about_the_target_once_it_is_found() -> None:
    """The first six about where it is believed, the others about where their photographs show it, aimed at it."""
    config = with_target_error(preset("campaign").with_values({**ROUGH, "seed.recentre_after": 6}), "rock", 3)
    mission = made(config, reconstructor := OnTheGround(), Flight(config, "rock", 3))
    model = mission.run_seed_phase()
    assert reconstructor.partial_captures == [f"seed_{k:02d}.png" for k in range(6)]
    found_m = np.array(mission.config.target_m)
    np.testing.assert_allclose(found_m, [0.5, 0.0, 0.75], atol=0.1)
    for k, capture in enumerate(mission.captures):
        about_m = np.array(config.target_m) if k < 6 else found_m
        assert np.linalg.norm(about_m - capture.viewpoint.position_m) == pytest.approx(4.0)
        aim_m = about_m - camera_centers_m(capture.camera_from_world)
        assert capture.camera_from_world[2, :3] @ aim_m == pytest.approx(np.linalg.norm(aim_m))
    mission.look_for_target(model)  # with all of them it is found again
    np.testing.assert_allclose(mission.config.target_m, found_m, atol=0.05)


CENTIMETRES = {f"telemetry.{axis}_noise_m": 0.02 for axis in ("horizontal", "vertical")}  # RTK


@pytest.mark.parametrize(
    "values",
    [
        {},
        {**ROUGH, "seed.recentre_after": 24},
        {"seed.recentre_after": 6},
        {**CENTIMETRES, "seed.recentre_after": 6},
    ],
)
def test_nobody_looks_for_a_target_that_is_known_or_all_seen(values: dict) -> None:
    config = with_target_error(preset("campaign").with_values(values), "rock", 3)
    mission = made(config, reconstructor := OnTheGround(), Flight(config, "rock", 3))
    mission.run_seed_phase()
    assert not hasattr(reconstructor, "partial_captures")
    assert mission.config is config


@pytest.mark.parametrize("ground_m", [-0.7, 0.0, 0.7])
def test_altitudes_count_from_the_ground_in_the_model(ground_m: float) -> None:
    """GNSS's drift moves the ground; a pool of the lowest ring alone stays that, and is not empty."""
    gnss = {"telemetry.horizontal_noise_m": 0.3, "telemetry.vertical_noise_m": 0.4, "telemetry.drift_m": 0.4}
    config = preset("campaign").with_values({**ROUGH, **gnss, "pool.max_altitude_m": 1.5})
    mission = made(config, OnTheGround(ground_m), Flight(config, "rock", 3))
    mission.run()
    assert mission.recorder.notes == []
    for capture in mission.captures[24:]:
        assert 1.3 <= capture.viewpoint.position_m[2] - ground_m <= 1.5
    assert mission.config.flight.keep_out_height_m == pytest.approx(2.2 + ground_m, abs=0.05)
    assert mission.config.target.ground_m == pytest.approx(ground_m, abs=0.05)


def test_without_a_target_in_the_model_belief_stays_and_it_is_looked_for_again() -> None:
    """Twenty points show nothing; those that later photographs add may."""
    config = with_target_error(preset("campaign").with_values(ROUGH), "rock", 3)
    mission = made(config, CountingReconstructor(points=20), Flight(config, "rock", 3))
    model = mission.run_seed_phase()
    assert with_target_found(config, model) is None
    mission.look_for_target(model)
    assert mission.config is config
    mission.look_for_target(OnTheGround()._model())
    np.testing.assert_allclose(mission.config.target_m, [0.5, 0.0, 0.75], atol=0.1)
    never = made(config, CountingReconstructor(points=1), Flight(config, "rock", 3))
    never.run()
    assert never.recorder.notes == ["target_not_found"]
