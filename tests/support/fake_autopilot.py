"""A MAVLink autopilot on loopback that answers as PX4 does, as far as `adapters.mavlink.vehicle` asks.

From PX4's documentation: offboard control is refused without a stream of set points and left when it ends; arming, mode and
landing are commands that are acknowledged; a landed vehicle disarms itself. It flies in a straight line, at once.
"""

import math
import threading
import time

from pymavlink import mavutil
from pymavlink.dialects.v20 import common as mavlink

_STREAM_S = 0.5  # COM_OF_LOSS_T
OFFBOARD, LAND = (6, 0), (4, 6)  # PX4's main and sub modes


class FakeAutopilot:
    """Flies in a thread; ``commands`` has the numbers of what it was told, ``deaf`` those that it denies."""

    def __init__(self, port, speed_m_s=40.0, deaf=(), position_after_s=0.0):
        self.link = mavutil.mavlink_connection(
            f"udpout:127.0.0.1:{port}", source_system=1, source_component=1, dialect="common"
        )
        self.at, self.yaw, self.goal, self.mode = [0.0, 0.0, 0.0], 0.0, None, (4, 3)
        self.armed, self.heard, self.speed_m_s, self.deaf = False, 0.0, speed_m_s, deaf
        self.commands, self.pushed, self.lowest_m = [], None, math.inf
        self.position_after_ms = 1000 * position_after_s
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._fly, daemon=True)
        self._thread.start()

    def close(self):
        self._over.set()
        self._thread.join(5)
        self.link.close()

    def _fly(self):
        started, beat = time.monotonic(), 0.0
        while not self._over.is_set():
            now = time.monotonic()
            if now - beat > 0.2:
                beat = now
                self._heartbeat()
            while (message := self.link.recv_msg()) is not None:
                self._hear(message, now)
            self._move(0.02)
            self._tell(int(1000 * (now - started)))
            time.sleep(0.02)

    def _heartbeat(self):
        mode = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | (
            mavlink.MAV_MODE_FLAG_SAFETY_ARMED if self.armed else 0
        )
        custom = self.mode[0] << 16 | self.mode[1] << 24
        self.link.mav.heartbeat_send(
            mavlink.MAV_TYPE_QUADROTOR, mavlink.MAV_AUTOPILOT_PX4, mode, custom, mavlink.MAV_STATE_ACTIVE
        )

    def _hear(self, message, now):
        kind = message.get_type()
        if kind == "SET_POSITION_TARGET_LOCAL_NED":
            self.goal, self.heard = [message.x, message.y, message.z, message.yaw], now
        if kind == "COMMAND_LONG":
            self.commands.append(message.command)
            result = self._obey(message, now)
            self.link.mav.command_ack_send(
                message.command, result, 0, 0, message.get_srcSystem(), message.get_srcComponent()
            )

    def _obey(self, message, now):
        if message.command in self.deaf:
            return mavlink.MAV_RESULT_DENIED
        if message.command == mavlink.MAV_CMD_COMPONENT_ARM_DISARM:
            self.armed = message.param1 == 1
        elif message.command == mavlink.MAV_CMD_DO_SET_MODE:
            wanted = (int(message.param2), int(message.param3))
            if wanted[0] == OFFBOARD[0] and now - self.heard > _STREAM_S:
                return mavlink.MAV_RESULT_TEMPORARILY_REJECTED
            self.mode = wanted
        elif message.command == mavlink.MAV_CMD_NAV_LAND:
            self.mode = LAND
        elif message.command in (mavlink.MAV_CMD_REQUEST_MESSAGE, mavlink.MAV_CMD_SET_MESSAGE_INTERVAL):
            return mavlink.MAV_RESULT_UNSUPPORTED
        self._heartbeat()
        return mavlink.MAV_RESULT_ACCEPTED

    def _move(self, seconds):
        if not self.armed:
            return
        if self.pushed is not None:
            self.at = list(self.pushed)
            return
        if self.mode == LAND:
            self.at[2] = min(0.0, self.at[2] + self.speed_m_s * seconds)
            if self.at[2] == 0.0:
                self.armed = False
                self._heartbeat()
            return
        if self.mode[0] != OFFBOARD[0] or self.goal is None:
            return
        if time.monotonic() - self.heard > _STREAM_S:
            self.mode = (4, 3)  # the failsafe: hold
            return
        *goal, self.yaw = self.goal
        left = math.dist(self.at, goal)
        share = min(1.0, self.speed_m_s * seconds / left) if left else 1.0
        self.at = [a + share * (g - a) for a, g in zip(self.at, goal)]
        if self.at[2] < -1.0:
            self.lowest_m = min(self.lowest_m, -self.at[2])

    def _tell(self, ms):
        if ms >= self.position_after_ms:
            self.link.mav.local_position_ned_send(ms, *self.at, 0.0, 0.0, 0.0)
        degrees = math.degrees(self.yaw) % 360
        self.link.mav.global_position_int_send(
            ms, 473977420, 85455940, 488000, int(-1000 * self.at[2]), 0, 0, 0, int(100 * degrees) % 36000
        )
        landed = mavlink.MAV_LANDED_STATE_IN_AIR if self.at[2] < -0.1 else mavlink.MAV_LANDED_STATE_ON_GROUND
        self.link.mav.extended_sys_state_send(0, landed)
