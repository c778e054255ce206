"""A mission's flight log: take-off, legs, hovering, landing, with total time and path."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.special import ndtr, ndtri

from nbv.config import FlightConfig, MissionConfig
from nbv.flight.energy import J_PER_WH, leg_energy_wh, power_w
from nbv.flight.leg import Leg, Pose
from nbv.flight.route import Airspace, pose_at
from nbv.flight.wind import mean_wind_m_s, sway_m
from nbv.geometry.frames import heading_to
from nbv.random_streams import keyed_rng
from nbv.types import Floats, Point, Viewpoint

SIGMAS_IN_TOLERANCE = 3.0


@dataclass(frozen=True)
class FlightEvent:
    """One thing the vehicle did, with the mission time at which it began."""

    name: str  # "take-off", a viewpoint's id, "return", "landing"
    start_s: float
    legs: tuple[Leg, ...]
    hover_s: float  # after the legs


class Flight:
    """The vehicle of one mission; ``rock_sha256`` and ``replicate`` are the key of its arrival errors.

    The camera is where the vehicle is, and the gimbal aims at the target, so arriving with a wrong
    position does not turn the target out of the image. ``flight_time_s`` counts everything from take-off to landing:
    climbs, legs and detours, ``settle_s`` before each photograph, and what `hover` waits for: while a view is planned,
    ``planning_s``.
    """

    def __init__(self, config: MissionConfig, rock_sha256: str, replicate: int) -> None:
        self._key = (rock_sha256, replicate)
        self._wind = config.wind
        self._space = Airspace(config.flight, config.target_m, mean_wind_m_s(config.wind, self._key))
        home = np.array(config.flight.home_m, dtype=float)
        self._pose = pose_at(home, float(heading_to(home, np.array(config.target_m))))
        self.flight_time_s = 0.0
        self.path_length_m = 0.0
        self.energy_wh = 0.0
        self.events: list[FlightEvent] = []

    def face(self, target_m: Point, limits: FlightConfig) -> None:
        """Head for a target there from now on and keep out of its cylinder; the limits may have other heights."""
        self._space = replace(self._space, target_m=target_m, limits=limits)

    @property
    def _limits(self) -> FlightConfig:
        return self._space.limits

    @property
    def position_m(self) -> Floats:
        """(3,) where the vehicle estimates to be."""
        return np.array(self._pose.position_m)

    @property
    def heading_rad(self) -> float:
        """Counter-clockwise from east."""
        return self._pose.heading_rad

    def take_off(self) -> None:
        """Climb from home to the take-off altitude."""
        x, y, z = self._pose.position_m
        up = Pose((x, y, z + self._limits.takeoff_altitude_m), self._pose.heading_rad)
        self._fly("take-off", self._space.straight(self._pose, up), 0.0)

    def fly_to(self, viewpoint: Viewpoint) -> Floats:
        """Fly to a viewpoint, around the rock if need be, and settle; returns the actual position (3,)."""
        arrived = arrival_position(viewpoint, self._limits, self._key)
        if self._wind.gust_m_s > 0:
            arrived += sway_m(self._wind, self._key, viewpoint.id)
            arrived[2] = max(arrived[2], self._limits.min_camera_altitude_m)
        end = pose_at(arrived, float(heading_to(arrived, np.array(self._space.target_m))))
        self._fly(viewpoint.id, self._space.route(self._pose, end), self._limits.settle_s)
        return arrived

    def hover(self, seconds: float) -> None:
        """Wait in the air."""
        self._fly("hover", (), seconds)

    def return_and_land(self) -> None:
        """Fly back above home and descend."""
        home = self._limits.home_m
        above = Pose((home[0], home[1], home[2] + self._limits.takeoff_altitude_m), self._pose.heading_rad)
        self._fly("return", self._space.route(self._pose, above), 0.0)
        down = Pose((home[0], home[1], home[2]), self._pose.heading_rad)
        self._fly("landing", self._space.straight(self._pose, down), 0.0)

    def samples(self) -> Floats:
        """(K, 5) t (s, mission time), x, y, z (m), heading (rad) of everything flown, at about 5 Hz."""
        parts = []
        for event in self.events:
            start_s = event.start_s
            for leg in event.legs:
                parts.append(leg.samples + np.array([start_s, 0.0, 0.0, 0.0, 0.0]))
                start_s += leg.duration_s
        return np.concatenate(parts) if parts else np.zeros((0, 5))

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON: totals, events, and the trajectory rounded to 0.1 ms, mm and mrad."""
        return {
            "flight_time_s": self.flight_time_s,
            "path_length_m": self.path_length_m,
            "energy_wh": self.energy_wh,
            "events": [
                {
                    "name": event.name,
                    "start_s": event.start_s,
                    "duration_s": sum(leg.duration_s for leg in event.legs),
                    "hover_s": event.hover_s,
                    "path_length_m": sum(leg.path_length_m for leg in event.legs),
                    "detour": len(event.legs) > 1,
                }
                for event in self.events
            ],
            "columns": ["t_s", "x_m", "y_m", "z_m", "heading_rad"],
            "samples": [
                [round(v, d) for v, d in zip(row, (4, 3, 3, 3, 3))] for row in self.samples().tolist()
            ],
        }

    def _fly(self, name: str, legs: tuple[Leg, ...], hover_s: float) -> None:
        self.events.append(FlightEvent(name, self.flight_time_s, legs, hover_s))
        self.flight_time_s += sum(leg.duration_s for leg in legs) + hover_s
        self.path_length_m += sum(leg.path_length_m for leg in legs)
        self.energy_wh += sum(leg_energy_wh(self._limits, leg) for leg in legs)
        self.energy_wh += power_w(self._limits) * hover_s / J_PER_WH
        if legs:
            self._pose = legs[-1].end


def arrival_position(viewpoint: Viewpoint, limits: FlightConfig, key: tuple[str, int]) -> Floats:
    """(3,) actual camera position (m) for a commanded viewpoint.

    The arrival test is a box of plus or minus ``arrival_tolerance_m`` per axis. A position controller
    does not use it up evenly: the error of each axis is normal with a third of the tolerance as standard
    deviation, truncated to the box. It is drawn per viewpoint and ``key``, (rock's SHA-256, replicate), so it does not
    depend on when or from where the viewpoint is flown to. Never below ``min_camera_altitude_m``.
    """
    uniform = keyed_rng("arrival", *key, viewpoint.id).random(3)
    edge = ndtr(-SIGMAS_IN_TOLERANCE)
    sigmas = ndtri(edge + uniform * (1.0 - 2.0 * edge))
    position: Floats = (
        np.array(viewpoint.position_m) + limits.arrival_tolerance_m / SIGMAS_IN_TOLERANCE * sigmas
    )
    position[2] = max(position[2], limits.min_camera_altitude_m)
    return position
