"""Telemetry's moments and drift; wind on the legs and at the photograph."""

import math

import numpy as np
import pytest

from nbv.config import (
    FlightConfig,
    MissionConfig,
    TelemetryConfig,
    WindConfig,
)
from nbv.flight import Flight, Pose
from nbv.flight.leg import fly_straight, ground_speed_m_s, mean_wind_m_s, sway_m
from nbv.flight.telemetry import TelemetryErrors
from nbv.geometry.frames import invert_rigid, look_at
from nbv.viewpoints import raw_candidates

REPORTED = look_at(np.array([0.0, -4.0, 2.0]), np.array([0.0, 0.0, 0.8]))
POSITION = np.array([0.0, -4.0, 2.0])


def errors_m(config: TelemetryConfig, count: int, time_s: float = 10.0) -> np.ndarray:
    """(count, 3) reported minus true position, one per replicate."""
    poses = [
        TelemetryErrors(config, "rock", k, 0.3).true_pose(REPORTED, "seed_00", time_s) for k in range(count)
    ]
    return POSITION - np.array([invert_rigid(pose)[:3, 3] for pose in poses])


def test_noise_has_the_configured_moments() -> None:
    config = TelemetryConfig(horizontal_noise_m=0.2, vertical_noise_m=0.1)
    found = errors_m(config, 4000)
    np.testing.assert_allclose(found.std(axis=0), [0.2, 0.2, 0.1], rtol=0.05)
    np.testing.assert_allclose(found.mean(axis=0), 0.0, atol=0.012)


def test_drift_correlates_by_one_over_e() -> None:
    config = TelemetryConfig(drift_m=0.5, drift_time_s=60.0)
    flights = [TelemetryErrors(config, "rock", k, 0.3) for k in range(3000)]
    now, later = (np.array([f.drift_m(t) for f in flights]) for t in (0.0, 60.0))
    np.testing.assert_allclose(now.std(axis=0), 0.5, rtol=0.06)
    correlation = [np.corrcoef(now[:, axis], later[:, axis])[0, 1] for axis in range(3)]
    np.testing.assert_allclose(correlation, np.exp(-1.0), atol=0.06)


def test_lever_arm_turns_with_the_heading() -> None:
    config = TelemetryConfig(drift_m=1e-9, lever_arm_m=(0.1, 0.02, 0.3))
    # The camera looks north: forward is +y, left is -x. It stands before and above the point that is reported.
    np.testing.assert_allclose(-errors_m(config, 1)[0], [-0.02, 0.1, 0.3], atol=1e-7)


def test_attitude_error_turns_the_camera_about_itself() -> None:
    config = TelemetryConfig(drift_m=1e-15, attitude_noise_deg=1.0)
    true = [TelemetryErrors(config, "rock", k, 0.3).true_pose(REPORTED, "seed_00", 0.0) for k in range(2000)]
    np.testing.assert_allclose([invert_rigid(pose)[:3, 3] for pose in true[:5]], [POSITION] * 5, atol=1e-12)
    cosine = [(np.trace(pose[:3, :3] @ REPORTED[:3, :3].T) - 1) / 2 for pose in true]
    angle_deg = np.rad2deg(np.arccos(np.clip(cosine, -1, 1)))
    assert np.sqrt((angle_deg**2).mean()) == pytest.approx(np.sqrt(3.0), rel=0.06)


LIMITS = FlightConfig()


EAST = Pose((0.0, 0.0, 3.0), 0.0), Pose((400.0, 0.0, 3.0), 0.0)


def test_a_long_leg_takes_its_length_over_the_ground_speed() -> None:
    calm = fly_straight(*EAST, LIMITS).duration_s
    for wind, speed in (((-2.0, 0.0), 3.0), ((0.0, 3.0), 4.0), ((2.0, 0.0), 5.0), ((-1.0, 3.0), 3.0)):
        assert ground_speed_m_s((1.0, 0.0), LIMITS, wind) == pytest.approx(speed)
        # At 3 m/s2 and 8 m/s3 starting and stopping cost a second or two, less at lower speeds.
        windy = fly_straight(*EAST, LIMITS, wind).duration_s
        assert windy - calm == pytest.approx(400 / speed - 400 / 5.0, abs=2.0)


def test_the_wind_blows_one_way_all_through_a_replicate() -> None:
    wind = WindConfig(mean_speed_m_s=3.0)
    drawn = {mean_wind_m_s(wind, ("rock", replicate)) for replicate in range(6)}
    assert len(drawn) == 6 and mean_wind_m_s(wind, ("rock", 0)) == mean_wind_m_s(wind, ("rock", 0))
    assert all(math.hypot(*w) == pytest.approx(3.0) for w in drawn)


def test_gusts_move_the_camera_by_what_the_hover_gives() -> None:
    wind = WindConfig(gust_m_s=1.0, sway_s=0.2)
    moved = np.array([sway_m(wind, ("rock", 0), f"v{i}") for i in range(3000)])
    np.testing.assert_allclose(moved.std(axis=0), [0.2, 0.2, 0.1], rtol=0.05)
    view = raw_candidates(MissionConfig())[0]
    windy = MissionConfig().with_values({"wind.gust_m_s": 1.0, "wind.sway_s": 0.2})
    off = Flight(windy, "rock", 0).fly_to(view) - Flight(MissionConfig(), "rock", 0).fly_to(view)
    np.testing.assert_allclose(off, sway_m(wind, ("rock", 0), view.id))
