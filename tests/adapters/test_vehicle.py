"""A flight through MAVSDK, against a MAVLink autopilot on loopback that answers as PX4 does."""

import socket

import numpy as np
import pytest

from nbv.config import preset
from nbv.errors import MissionFailure, UserError
from nbv.types import Viewpoint

pytest.importorskip("mavsdk", reason="the extra mavsdk is absent: pip install gatetune[mavsdk]")
pytest.importorskip("pymavlink", reason="pymavlink is absent: pip install gatetune[dev]")

from fake_autopilot import FakeAutopilot

from adapters.mavlink.vehicle import Limits, MavsdkFlight

CONFIG = preset("paper").with_values({"flight.settle_s": 0.1})
VIEW = Viewpoint("cand_000", (3.0, -1.5, 2.4), -27.0, 27.0, "lateral")


@pytest.fixture
def vehicle():
    """(flight, autopilot), connected; made with what a test asks for."""
    open_ = []

    def make(abort=lambda: False, limits=None, **autopilot):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
            free.bind(("127.0.0.1", 0))
            port = free.getsockname()[1]
        there = FakeAutopilot(port, **autopilot)
        open_.append(there)
        flight = MavsdkFlight(CONFIG, f"udpin://127.0.0.1:{port}", limits, abort)
        open_.append(flight)
        return flight, there

    yield make
    for each in reversed(open_):
        each.close()


def test_it_takes_off_views_captures_and_lands(vehicle):
    flight, there = vehicle()
    flight.take_off()
    height = CONFIG.flight.home_m[2] + CONFIG.flight.takeoff_altitude_m
    assert there.armed and abs(flight.position_m[2] - height) < 0.36
    arrived = flight.fly_to(VIEW)
    np.testing.assert_allclose(arrived, VIEW.position_m, atol=CONFIG.flight.arrival_tolerance_m)
    to_target = np.array(CONFIG.target_m[:2]) - arrived[:2]
    assert abs(np.angle(np.exp(1j * (flight.heading_rad - np.arctan2(to_target[1], to_target[0]))))) < 0.1
    flight.capture()
    flight.return_and_land()
    assert not there.armed and there.at[2] == 0.0
    assert {1000, 2000} <= set(there.commands)  # the gimbal was aimed, a photograph taken
    assert flight.flight_time_s > 0.1 and flight.path_length_m > 5


def test_it_arms_only_where_it_knows_where_it_is(vehicle):
    flight, there = vehicle(position_after_s=0.8)
    flight.take_off()
    assert there.armed and flight.position_m[2] > 1
    flight, there = vehicle(limits=Limits(leg_limit_s=0.2), position_after_s=60.0)
    with pytest.raises(MissionFailure, match="no position") as failure:
        flight.take_off()
    assert failure.value.reason == "no_position" and not there.armed


@pytest.mark.parametrize("at", [(40.0, 0.0, 2.0), (3.0, 0.0, 0.2), (3.0, 0.0, 30.0)])
def test_a_target_outside_the_fence_is_not_flown_to(vehicle, at):
    flight, _ = vehicle()
    flight.take_off()
    before = flight.position_m
    with pytest.raises(MissionFailure, match="the limits are 15 m, 1 to 10 m"):
        flight.fly_to(Viewpoint("x", at, 0.0, 0.0, "lateral"))
    np.testing.assert_allclose(flight.position_m, before, atol=0.4)


def test_one_that_leaves_the_fence_lands(vehicle):
    flight, there = vehicle()
    flight.take_off()
    there.pushed = (30.0, 0.0, -3.0)  # a gust
    with pytest.raises(MissionFailure, match="from home") as failure:
        there_later(there)
        flight.fly_to(VIEW)
    assert failure.value.reason == "fence_left" and not there.armed


def there_later(there):
    import threading

    threading.Timer(0.5, lambda: setattr(there, "pushed", None)).start()


def test_an_abort_lands_where_it_is(vehicle):
    asked = []
    flight, there = vehicle(abort=lambda: bool(asked), speed_m_s=8.0)
    flight.take_off()
    asked.append(True)
    with pytest.raises(MissionFailure, match="abort") as failure:
        flight.fly_to(VIEW)
    assert failure.value.reason == "aborted" and not there.armed


def test_a_pilot_who_takes_over_is_left_alone(vehicle):
    flight, there = vehicle(speed_m_s=4.0)
    flight.take_off()
    there.mode = (3, 0)  # position control, by stick
    there._heartbeat()
    with pytest.raises(MissionFailure) as failure:
        flight.hover(5.0)
    assert failure.value.reason == "taken_over" and there.armed and 21 not in there.commands


def test_a_refusal_is_one_line(vehicle):
    flight, _ = vehicle(deaf=(400,))
    with pytest.raises(MissionFailure, match="arm: ") as failure:
        flight.take_off()
    assert "\n" not in failure.value.message


def test_nobody_there_is_one_line():
    with pytest.raises(UserError, match="no autopilot answers at udpin"):
        MavsdkFlight(CONFIG, "udpin://127.0.0.1:47999", Limits(), connect_limit_s=0.3)
