"""A flight that is not simulated: what the mission loop asks of `nbv.flight.Flight`, flown by an autopilot through MAVSDK.

Needs the extra ``mavsdk``. Tried against a MAVLink autopilot on loopback that answers as PX4 does, never on a vehicle or
PX4's own simulation: try it there first, with a pilot. The fence here only keeps targets in and lands where the vehicle
leaves it; set the autopilot's own as well. Legs are straight, without the simulation's detours round the rock: the take-off
altitude and the candidates' radius must keep them clear of it.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import mavsdk
import numpy as np
from mavsdk.plugins.action import Action
from mavsdk.plugins.mavlink_direct import MavlinkDirect, MavlinkMessage
from mavsdk.plugins.offboard import Offboard, PositionNedYaw
from mavsdk.plugins.telemetry import Telemetry

from nbv.config import MissionConfig
from nbv.errors import MissionFailure, UserError
from nbv.geometry.frames import heading_to
from nbv.types import Floats, Viewpoint

_POLL_S = 0.05
_MANAGER_PITCHYAW, _CAPTURE = 1000, 2000  # MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW, MAV_CMD_IMAGE_START_CAPTURE


@dataclass(frozen=True)
class Limits:
    """Where the vehicle may be; a target outside is refused before it is flown to."""

    radius_m: float = 15.0  # horizontally from take-off
    min_height_m: float = 1.0  # above take-off
    max_height_m: float = 10.0
    leg_limit_s: float = 60.0  # for one leg, climb or descent


class MavsdkFlight:
    """The vehicle of one mission, in the mission's frame (east, north, up, the target above the origin).

    Parameters
    ----------
    config
        ``flight.home_m`` is where the vehicle stands, ``flight.settle_s`` and ``arrival_tolerance_m`` are heeded.
    address
        As MAVSDK has it, for example ``udpin://0.0.0.0:14540``.
    abort
        Asked all the time; once it says true the vehicle lands where it is.

    Raises
    ------
    UserError
        Nobody answers at ``address``.
    """

    def __init__(
        self,
        config: MissionConfig,
        address: str,
        limits: Limits | None = None,
        abort: Callable[[], bool] = lambda: False,
        connect_limit_s: float = 10.0,
    ) -> None:
        self._settings, self._limits, self._abort = config.flight, limits or Limits(), abort
        self._target_m = np.array(config.target_m)
        self._home_m = np.array(config.flight.home_m, dtype=float)
        ground_station = mavsdk.Configuration.create_with_component_type(mavsdk.ComponentType.GROUND_STATION)
        self._mavsdk = mavsdk.Mavsdk(ground_station)
        added = self._mavsdk.add_any_connection(address)
        system = self._mavsdk.first_autopilot(connect_limit_s)
        if system is None:
            self._mavsdk.destroy()
            raise UserError(f"no autopilot answers at {address} ({added}); start it, or mend the address")
        self._action, self._offboard = Action(system), Offboard(system)
        self._telemetry, self._direct = Telemetry(system), MavlinkDirect(system)
        self.flight_time_s = 0.0
        self.path_length_m = 0.0

    def close(self) -> None:
        """Let go of the connection; the vehicle stays as it is."""
        self._mavsdk.destroy()

    def face(self, target_m: tuple[float, float, float]) -> None:
        """From now on head for, and aim at, a target there."""
        self._target_m = np.array(target_m)

    @property
    def position_m(self) -> Floats:
        """(3,) where the autopilot believes to be."""
        at = self._telemetry.position_velocity_ned().position
        return self._home_m + np.array((at.east_m, at.north_m, -at.down_m))

    @property
    def heading_rad(self) -> float:
        """Counter-clockwise from east."""
        return math.pi / 2 - math.radians(self._telemetry.heading().heading_deg)

    def take_off(self) -> None:
        """Arm and climb to the take-off altitude."""
        up = self._above_home()
        self._refuse_outside(up)
        self._wait_for_position()
        heading = float(heading_to(up, self._target_m))
        self._set_point(self._home_m, heading)  # PX4 wants a stream of set points before it goes offboard
        self._do("arm", self._action.arm)
        self._do("offboard", self._offboard.start)
        self._go(up, heading)

    def fly_to(self, viewpoint: Viewpoint) -> Floats:
        """Fly straight to a viewpoint, aim, settle; the position (3,) then."""
        goal = np.array(viewpoint.position_m)
        self._refuse_outside(goal)
        self._go(goal, float(heading_to(goal, self._target_m)))
        delta = self._target_m - goal
        pitch = math.degrees(math.atan2(delta[2], float(np.hypot(*delta[:2]))))
        self._command(_MANAGER_PITCHYAW, pitch, 0.0)
        self.hover(self._settings.settle_s)
        return self.position_m

    def hover(self, seconds: float) -> None:
        """Wait in the air."""
        started = time.monotonic()
        while time.monotonic() - started < seconds:
            self._guard()
            time.sleep(_POLL_S)
        self.flight_time_s += time.monotonic() - started

    def capture(self) -> None:
        """Have the camera take one photograph; it stays on the camera."""
        self._command(_CAPTURE, 0.0, 0.0, 1.0)

    def return_and_land(self) -> None:
        """Fly back above home and land; returns when the motors have stopped."""
        self._go(self._above_home(), self.heading_rad)
        self.land()

    def land(self) -> None:
        """Land here and now."""
        started = time.monotonic()
        self._do("land", self._action.land)
        while self._telemetry.armed():
            if time.monotonic() - started > self._limits.leg_limit_s:
                raise MissionFailure(
                    "not_landed", f"armed {self._limits.leg_limit_s:g} s after it was told to land"
                )
            time.sleep(_POLL_S)
        self.flight_time_s += time.monotonic() - started

    def _above_home(self) -> Floats:
        return self._home_m + np.array((0.0, 0.0, self._settings.takeoff_altitude_m))

    def _go(self, goal_m: Floats, heading_rad: float) -> None:
        started, before = time.monotonic(), self.position_m
        self._set_point(goal_m, heading_rad)
        while (
            not np.abs(self.position_m - goal_m).max() <= self._settings.arrival_tolerance_m
        ):  # NaN is nowhere
            self._guard()
            if time.monotonic() - started > self._limits.leg_limit_s:
                self._end("stuck", f"not there after {self._limits.leg_limit_s:g} s")
            time.sleep(_POLL_S)
        self.flight_time_s += time.monotonic() - started
        self.path_length_m += float(np.linalg.norm(self.position_m - before))

    def _wait_for_position(self) -> None:
        """MAVSDK says NaN until the first message has come."""
        started = time.monotonic()
        while np.isnan(self.position_m).any():
            if time.monotonic() - started > self._limits.leg_limit_s:
                raise MissionFailure(
                    "no_position", f"the autopilot gives no position in {self._limits.leg_limit_s:g} s"
                )
            time.sleep(_POLL_S)

    def _guard(self) -> None:
        if self._abort():
            self._end("aborted", "the abort was asked for")
        if not self._offboard.is_active():
            self._end(
                "taken_over", "the autopilot has left offboard control: a pilot, or a failsafe of its own"
            )
        height, radius = self._where(self.position_m)
        if math.isnan(height + radius):
            self._end("position_lost", "the autopilot does not know where it is")
        slack = self._settings.arrival_tolerance_m
        if radius > self._limits.radius_m + slack or height > self._limits.max_height_m + slack:
            self._end("fence_left", f"{radius:.1f} m from home, {height:.1f} m above it")

    def _end(self, reason: str, message: str) -> None:
        """Land, unless somebody else flies, and give the mission up."""
        if reason != "taken_over":
            self.land()
        raise MissionFailure(reason, message)

    def _where(self, position_m: Floats) -> tuple[float, float]:
        relative = position_m - self._home_m
        return float(relative[2]), float(np.hypot(*relative[:2]))

    def _refuse_outside(self, goal_m: Floats) -> None:
        height, radius = self._where(goal_m)
        at = self._limits
        if radius > at.radius_m or not at.min_height_m <= height <= at.max_height_m:
            raise MissionFailure(
                "outside_fence",
                f"{radius:.1f} m from home and {height:.1f} m above it; the limits are {at.radius_m:g} m, "
                f"{at.min_height_m:g} to {at.max_height_m:g} m",
            )

    def _set_point(self, goal_m: Floats, heading_rad: float) -> None:
        """MAVSDK repeats it by itself."""
        east, north, up = (float(v) for v in goal_m - self._home_m)
        yaw = math.degrees(math.pi / 2 - heading_rad)
        self._do("set point", lambda: self._offboard.set_position_ned(PositionNedYaw(north, east, -up, yaw)))

    def _command(self, number: int, *parameters: float) -> None:
        fields: dict[str, Any] = {f"param{i}": 0.0 for i in range(1, 8)}
        fields |= {f"param{i}": value for i, value in enumerate(parameters, 1)}
        fields |= {"command": number, "confirmation": 0, "target_system": 1, "target_component": 1}
        message = MavlinkMessage("COMMAND_LONG", 0, 0, 1, 1, json.dumps(fields))
        self._do(f"command {number}", lambda: self._direct.send_message(message))

    @staticmethod
    def _do(what: str, call: Callable[[], Any]) -> None:
        try:
            call()
        except Exception as error:  # each plugin has an exception of its own
            raise MissionFailure("autopilot_refused", f"{what}: {' '.join(str(error).split())}") from error
