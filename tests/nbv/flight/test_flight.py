"""Legs, detours, arrivals and totals; wind on the way, and telemetry that errs."""

import json

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st
from refusals import refused

from nbv.config import FlightConfig, MissionConfig, TelemetryConfig, WindConfig, preset
from nbv.flight import Airspace, Flight, Pose
from nbv.flight.flight import arrival_position
from nbv.flight.leg import fly_straight, ground_speed_m_s, power_w, sway_m
from nbv.flight.telemetry import TelemetryErrors
from nbv.geometric import run_geometric_mission
from nbv.geometry.frames import heading_to, invert_rigid, look_at, wrap_angle
from nbv.viewpoints import raw_candidates, seed_viewpoints

LIMITS = FlightConfig()
TARGET = (0.0, 0.0, 0.8)
coordinate = st.floats(-6.0, 6.0, allow_nan=False)
poses = st.builds(
    lambda x, y, z, h: Pose((x, y, z), h), coordinate, coordinate, st.floats(0.3, 6.0), st.floats(-3.14, 3.14)
)


def test_a_long_level_leg_has_a_closed_form() -> None:
    """L / v to cruise, and v / a + a / j to speed up and slow down under limited jerk."""
    leg = fly_straight(Pose((0, 0, 3), 0.0), Pose((60, 80, 3), 0.0), LIMITS)
    v, a, j = LIMITS.max_speed_m_s, LIMITS.max_acceleration_m_s2, LIMITS.max_jerk_m_s3
    assert leg.duration_s == pytest.approx(100 / v + v / a + a / j)
    assert leg.path_length_m == pytest.approx(100)


def test_a_climb_obeys_the_climb_limit() -> None:
    leg = fly_straight(Pose((0, 0, 1), 0.0), Pose((0, 0, 41), 0.0), LIMITS)
    v, a, j = LIMITS.max_climb_m_s, LIMITS.max_acceleration_m_s2, LIMITS.max_jerk_m_s3
    # The acceleration limit is not reached if v < a^2 / j: then speeding up takes 2 sqrt(v / j).
    ramp = v / a + a / j if v >= a * a / j else 2 * np.sqrt(v / j)
    assert leg.duration_s == pytest.approx(40 / v + ramp)


@settings(max_examples=60)
@given(start=poses, end=poses)
def test_limits_hold_along_the_leg(start: Pose, end: Pose) -> None:
    leg = fly_straight(start, end, LIMITS)
    t, xyz, heading = leg.samples[:, 0], leg.samples[:, 1:4], leg.samples[:, 4]
    np.testing.assert_allclose(xyz[0], start.position_m, atol=1e-9)
    np.testing.assert_allclose(xyz[-1], end.position_m, atol=1e-6)
    assert abs(float(wrap_angle(heading[-1] - end.heading_rad))) < 1e-6
    assert leg.path_length_m == pytest.approx(np.linalg.norm(np.subtract(end.position_m, start.position_m)))
    if len(t) < 2 or leg.duration_s == 0:
        return
    dt = np.diff(t)
    keep = dt > 1e-9  # mean speeds over the samples' intervals cannot exceed the limits
    velocity = np.diff(xyz, axis=0)[keep] / dt[keep, None]
    assert (np.hypot(velocity[:, 0], velocity[:, 1]) <= LIMITS.max_speed_m_s + 1e-6).all()
    assert (np.abs(velocity[:, 2]) <= LIMITS.max_climb_m_s + 1e-6).all()
    rate = np.abs(wrap_angle(np.diff(heading))[keep]) / dt[keep]
    assert (rate <= LIMITS.max_yaw_rate_rad_s + 1e-6).all()
    # Acceleration from the change of mean speed over neighbouring 0.2 s intervals.
    speed = np.linalg.norm(velocity, axis=1)[:-1] if len(velocity) > 2 else np.zeros(0)
    assert (np.abs(np.diff(speed)) / 0.2 <= LIMITS.max_acceleration_m_s2 + 1e-6).all()


def segment_distance(leg_samples: np.ndarray, height: float) -> float:
    low = leg_samples[leg_samples[:, 3] < height]
    return float(np.hypot(low[:, 1], low[:, 2]).min()) if len(low) else np.inf


inside = st.builds(
    lambda far, a, z: Pose((far * np.cos(a), far * np.sin(a), z), 0.0),
    st.floats(0.05, 1.29),
    st.floats(0, 6),
    st.floats(0.3, 2.1),
)


@example(start=Pose((0.0, 0.0, 3.0), 0.0), end=Pose((0.0, 1.3125, 1.0), 0.0))
@example(start=Pose((0.0, 1.3125, 1.0), 0.0), end=Pose((0.2, 0.0, 3.0), 0.0))
@example(start=Pose((0.28, -0.96, 1.0), 0.0), end=Pose((0.0, 1.0, 1.0), 0.0))  # both inside, no corner
@settings(max_examples=400)
@given(start=poses | inside, end=poses)
def test_no_leg_goes_nearer_to_the_axis_than_the_keep_out_or_its_ends(start: Pose, end: Pose) -> None:
    radius, height = LIMITS.keep_out_radius_m, LIMITS.keep_out_height_m
    ends = [np.hypot(*p.position_m[:2]) for p in (start, end) if p.position_m[2] < height]
    assume(all(0.05 < far < radius or far >= radius + 0.01 for far in ends))
    legs = Airspace(LIMITS, TARGET).route(start, end)
    assert legs[0].start == start and legs[-1].end == end
    for leg in legs:
        dense = np.linspace(leg.start.position_m, leg.end.position_m, 400)
        nearest = segment_distance(np.insert(dense, 0, 0, axis=1), height - 1e-9)
        assert nearest >= min([radius, *ends]) - 1e-9
    if min(ends, default=radius) >= radius:
        assert len(legs) <= 2
        assert all(leg.end.position_m[2] >= min(start.position_m[2], end.position_m[2]) for leg in legs)


@pytest.mark.parametrize(
    ("values", "says"),
    [
        ({"flight.home_m": [0.6, 0.3, 0.0]}, "inside the keep-out of 1.3 m"),
        ({"flight.home_m": [5.6, 0.3, 0.0], "target_m": [5, 0, 0.8]}, "inside the keep-out"),
        ({"flight.home_m": [0.6, 0.3, 0.0], "flight.keep_out_radius_m": 0.0}, "lies inside slab"),
        ({"flight.home_m": [0.6, 0.3, 1.0], "flight.keep_out_height_m": 0.5}, "lies inside slab"),
    ],
)
def test_a_home_in_the_rock_or_its_keep_out_is_refused(values, says) -> None:
    refused(says, lambda: run_geometric_mission(preset("campaign").with_values(values), "slab-3"))


def test_arrival_error_is_within_tolerance_and_spread() -> None:
    viewpoints = raw_candidates(MissionConfig())
    errors = np.array(
        [arrival_position(v, LIMITS, ("rock", r)) - v.position_m for v in viewpoints for r in range(20)]
    )
    assert np.abs(errors).max() <= LIMITS.arrival_tolerance_m
    np.testing.assert_allclose(errors.mean(axis=0), 0.0, atol=0.01)
    np.testing.assert_allclose(errors.std(axis=0), 0.35 / 3, rtol=0.05)  # truncation takes 1 %
    assert np.abs(np.corrcoef(errors.T) - np.eye(3)).max() < 0.06


def test_a_mission_adds_up() -> None:
    config = MissionConfig()
    flight = Flight(config, "rock", 0)
    np.testing.assert_array_equal(flight.position_m, config.flight.home_m)
    flight.take_off()
    for seed in seed_viewpoints(config):
        position = flight.fly_to(seed)
        np.testing.assert_array_equal(position, flight.position_m)
        assert flight.heading_rad == pytest.approx(float(heading_to(position, np.array(TARGET))))
    flight.return_and_land()
    np.testing.assert_array_equal(flight.position_m, config.flight.home_m)

    log = flight.to_dict()
    names = [event["name"] for event in log["events"]]
    assert names == ["take-off", *(f"seed_{i:02d}" for i in range(24)), "return", "landing"]
    assert log["flight_time_s"] == pytest.approx(sum(e["duration_s"] + e["hover_s"] for e in log["events"]))
    assert log["path_length_m"] == pytest.approx(sum(e["path_length_m"] for e in log["events"]))
    assert sum(e["hover_s"] for e in log["events"]) == 24 * config.flight.settle_s
    json.dumps(log)

    samples = flight.samples()
    assert (np.diff(samples[:, 0]) >= -1e-9).all()
    assert samples[-1, 0] == pytest.approx(flight.flight_time_s)
    chords = np.linalg.norm(np.diff(samples[:, 1:4], axis=0), axis=1).sum()
    assert chords == pytest.approx(flight.path_length_m, rel=1e-6)
    assert segment_distance(samples, 1.7) > 1.0  # nowhere near the rock


def test_energy_is_that_of_hovering_and_more_in_a_climb() -> None:
    """T^1.5 / sqrt(2 rho A) over the efficiency in hover; far above v_h a climb costs the weight times its rate."""
    area = 4 * np.pi * (LIMITS.rotor_diameter_m / 2) ** 2
    weight = LIMITS.mass_kg * 9.81
    hover = weight**1.5 / np.sqrt(2 * 1.225 * area) / LIMITS.propulsion_efficiency
    assert power_w(LIMITS) == pytest.approx(hover) and 180 < hover < 210
    assert power_w(LIMITS, 300.0) == pytest.approx(weight * 300.0 / LIMITS.propulsion_efficiency, rel=1e-3)
    assert power_w(LIMITS, -1.0) == power_w(LIMITS)
    flight = Flight(MissionConfig(), "rock", 0)
    flight.hover(60.0)
    assert flight.energy_wh == pytest.approx(hover / 60)
    flight.take_off()
    assert flight.energy_wh > hover * flight.flight_time_s / 3600


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


EAST = Pose((0.0, 0.0, 3.0), 0.0), Pose((400.0, 0.0, 3.0), 0.0)


def test_a_long_leg_takes_its_length_over_the_ground_speed() -> None:
    calm = fly_straight(*EAST, LIMITS).duration_s
    for wind, speed in (((-2.0, 0.0), 3.0), ((0.0, 3.0), 4.0), ((2.0, 0.0), 5.0), ((-1.0, 3.0), 3.0)):
        assert ground_speed_m_s((1.0, 0.0), LIMITS, wind) == pytest.approx(speed)
        # At 3 m/s2 and 8 m/s3 starting and stopping cost a second or two, less at lower speeds.
        windy = fly_straight(*EAST, LIMITS, wind).duration_s
        assert windy - calm == pytest.approx(400 / speed - 400 / 5.0, abs=2.0)


def test_gusts_move_the_camera_by_what_the_hover_gives() -> None:
    wind = WindConfig(gust_m_s=1.0, sway_s=0.2)
    moved = np.array([sway_m(wind, ("rock", 0), f"v{i}") for i in range(3000)])
    np.testing.assert_allclose(moved.std(axis=0), [0.2, 0.2, 0.1], rtol=0.05)
    view = raw_candidates(MissionConfig())[0]
    windy = MissionConfig().with_values({"wind.gust_m_s": 1.0, "wind.sway_s": 0.2})
    off = Flight(windy, "rock", 0).fly_to(view) - Flight(MissionConfig(), "rock", 0).fly_to(view)
    np.testing.assert_allclose(off, sway_m(wind, ("rock", 0), view.id))
