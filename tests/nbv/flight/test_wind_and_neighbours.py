"""Wind on the legs and at the photograph; neighbours that the vehicle keeps out of."""

from __future__ import annotations

import math

import numpy as np
import pytest

from nbv.config import FlightConfig, MissionConfig, WindConfig
from nbv.flight import Flight, Pose, fly_straight
from nbv.flight.wind import ground_speed_m_s, mean_wind_m_s, sway_m
from nbv.terrain import neighbour_cylinders
from nbv.viewpoints import raw_candidates, seed_viewpoints

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
    drawn = {mean_wind_m_s(wind, "rock", replicate) for replicate in range(6)}
    assert len(drawn) == 6 and mean_wind_m_s(wind, "rock", 0) == mean_wind_m_s(wind, "rock", 0)
    assert all(math.hypot(*w) == pytest.approx(3.0) for w in drawn)


def test_gusts_move_the_camera_by_what_the_hover_gives() -> None:
    wind = WindConfig(gust_m_s=1.0, sway_s=0.2)
    moved = np.array([sway_m(wind, "rock", 0, f"v{i}") for i in range(3000)])
    np.testing.assert_allclose(moved.std(axis=0), [0.2, 0.2, 0.1], rtol=0.05)
    view = raw_candidates(MissionConfig())[0]
    windy = MissionConfig().with_values({"wind.gust_m_s": 1.0, "wind.sway_s": 0.2})
    off = Flight(windy, "rock", 0).fly_to(view) - Flight(MissionConfig(), "rock", 0).fly_to(view)
    np.testing.assert_allclose(off, sway_m(wind, "rock", 0, view.id))


@pytest.mark.parametrize("seed", range(6))
def test_nothing_flown_passes_through_a_neighbour(seed: int) -> None:
    values = {
        "scene.ground_seed": seed,
        "ground.neighbours": 8,
        "ground.neighbour_height_m": [0.8, 1.5],
        "ground.relief_m": 0.05,
        "pool.min_altitude_m": 0.3,
        "wind.gust_m_s": 0.8,
    }
    config = MissionConfig().with_values(values)
    flight = Flight(config, "rock", seed)
    flight.take_off()
    views = [*seed_viewpoints(config), *raw_candidates(config)[seed::9]]
    detours = 0
    for view in views:
        flight.fly_to(view)
        detours += len(flight.events[-1].legs) > 1
    flight.return_and_land()
    legs = [leg for event in flight.events for leg in event.legs]
    ends = np.array([(leg.start.position_m, leg.end.position_m) for leg in legs])
    along = np.linspace(0, 1, 60)[:, None, None]
    places = (ends[:, 0] + along * (ends[:, 1] - ends[:, 0])).reshape(-1, 3)
    for c in neighbour_cylinders(config.ground, seed, "rock"):
        near = np.hypot(*(places[:, :2] - c.center_m).T) < c.radius_m + 0.29
        assert not (near & (places[:, 2] < c.top_m + 0.29)).any()
    assert detours > 0
