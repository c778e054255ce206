"""The route of a mission as a QGroundControl ``.plan``: take-off, photographs, return.

File format version 1 of QGroundControl's developer guide; commands are numbered as in MAVLink's common message set.
The route is fixed: on the vehicle nothing is planned any more.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import lazy_loader
import numpy as np

from nbv.cache import Store
from nbv.config import MissionConfig, config_from_dict
from nbv.errors import UserError
from nbv.flight import Airspace, Pose
from nbv.flight.flight import pose_at
from nbv.flight.leg import Leg
from nbv.geometry.frames import heading_to
from nbv.mission.result import MissionResult
from nbv.mission.run_directory import CONFIG, FLIGHT, LOCATED
from nbv.rocks import Rock
from nbv.safe_files import RESULT_BYTES, read_json, read_yaml
from nbv.types import Floats, Viewpoint
from nbv.viewpoints import raw_candidates, seed_viewpoints
from tuner.missions.registry import mission_kind

pyproj: Any = lazy_loader.load("pyproj")  # loaded by every command, and one uses it
WAYPOINT, RETURN_TO_LAUNCH, TAKEOFF = 16, 20, 22
CHANGE_SPEED, GIMBAL_PITCHYAW, TAKE_PHOTOGRAPH = 178, 1000, 2000
GLOBAL_RELATIVE_ALTITUDE, NO_POSITION = 3, 2  # frames
GROUND_SPEED, SAME_THROTTLE = 1, -1  # of CHANGE_SPEED
PX4, MULTIROTOR = 12, 2


@dataclass(frozen=True)
class Home:
    """Where the mission's take-off point lies."""

    latitude_deg: float
    longitude_deg: float
    altitude_m: float = 0.0  # above mean sea level

    def __post_init__(self) -> None:
        if not (abs(self.latitude_deg) <= 89 and abs(self.longitude_deg) <= 180):
            raise UserError(
                f"home {self.latitude_deg:g}, {self.longitude_deg:g} is not on the map; give latitude (-89 to 89) and "
                "longitude (-180 to 180) in degrees"
            )
        if not math.isfinite(self.altitude_m):
            raise UserError(
                f"the altitude of home is {self.altitude_m:g}; give metres above mean sea level, or leave it out"
            )

    def place(self, east_m: float, north_m: float) -> tuple[float, float]:
        """Return (latitude, longitude) in degrees of a point near home."""
        azimuth_deg, distance_m = math.degrees(math.atan2(east_m, north_m)), math.hypot(east_m, north_m)
        home = self.longitude_deg, self.latitude_deg
        longitude_deg, latitude_deg, _ = pyproj.Geod(ellps="WGS84").fwd(*home, azimuth_deg, distance_m)
        return latitude_deg, longitude_deg


def qgc_plan(config: MissionConfig, view_ids: Sequence[str], home: Home) -> dict[str, Any]:
    """Return the plan as a JSON tree.

    ``view_ids``: photographs in their order, such as ``seed_00``, ``cand_017`` and, for a view flown again, ``cand_017b``.

    Raises `UserError`: a view that the configuration does not have.
    """
    known = {view.id: view for view in (*seed_viewpoints(config), *raw_candidates(config))}
    places = [name.rstrip("b") for name in view_ids]
    unknown = [name for name in places if name not in known]
    if unknown:
        raise UserError(
            f"view {unknown[0]!r} is none of this configuration's seeds and candidates; restore the config.yaml that it was flown with"
        )
    space = Airspace(config.flight, config.target_m)
    items = [
        {**item, "doJumpId": i, "autoContinue": True, "type": "SimpleItem"}
        for i, item in enumerate(_items(space, config, [known[name] for name in places], home), start=1)
    ]
    return {
        "fileType": "Plan",
        "version": 1,
        "groundStation": "gatetune",
        "mission": {
            "version": 2,
            "firmwareType": PX4,
            "vehicleType": MULTIROTOR,
            "cruiseSpeed": config.flight.max_speed_m_s,
            "hoverSpeed": config.flight.max_speed_m_s,
            "plannedHomePosition": [home.latitude_deg, home.longitude_deg, home.altitude_m],
            "items": items,
        },
        "geoFence": {"version": 2, "circles": [], "polygons": []},
        "rallyPoints": {"version": 2, "points": []},
    }


def _items(
    space: Airspace, config: MissionConfig, views: Sequence[Viewpoint], home: Home
) -> Iterator[dict[str, Any]]:
    x, y, z = config.flight.home_m
    target = np.array(config.target_m)
    above_home = pose = _pose((x, y, z + config.flight.takeoff_altitude_m), target)
    yield _at(TAKEOFF, (0.0, 0.0, 0.0), pose, config, home)
    # `cruiseSpeed` and `hoverSpeed` of the plan only serve to estimate its duration.
    speed = [GROUND_SPEED, config.flight.max_speed_m_s, SAME_THROTTLE, 0, 0, 0, 0]
    yield {"command": CHANGE_SPEED, "frame": NO_POSITION, "params": speed}
    for view in views:
        end = _pose(view.position_m, target)
        legs = space.route(pose, end)
        yield from _passed(legs[:-1], config, home)  # the corners of a detour
        # Before the waypoint, whose hover then waits for the gimbal, too: an order without a place is carried out on the way.
        east_m, north_m, up_m = target - end.position_m
        pitch_deg = math.degrees(math.atan2(up_m, math.hypot(east_m, north_m)))
        yield {
            "command": GIMBAL_PITCHYAW,
            "frame": NO_POSITION,
            "params": [pitch_deg, 0, 0, 0, 0, 0, 0],
        }
        yield _at(
            WAYPOINT, (config.flight.settle_s, config.flight.arrival_tolerance_m, 0.0), end, config, home
        )
        yield {"command": TAKE_PHOTOGRAPH, "frame": NO_POSITION, "params": [0, 0, 1, 0, 0, 0, 0]}
        pose = end
    # The command alone goes straight home, through the target where that lies between.
    yield from _passed(space.route(pose, above_home), config, home)
    yield {"command": RETURN_TO_LAUNCH, "frame": NO_POSITION, "params": [0] * 7}


def _passed(legs: Sequence[Leg], config: MissionConfig, home: Home) -> Iterator[dict[str, Any]]:
    for leg in legs:
        yield _at(WAYPOINT, (0.0, config.flight.arrival_tolerance_m, 0.0), leg.end, config, home)


def _pose(position_m: Any, target_m: Any) -> Pose:
    return pose_at(np.array(position_m), float(heading_to(np.array(position_m), target_m)))


def _at(
    command: int, first: tuple[float, float, float], pose: Pose, config: MissionConfig, home: Home
) -> dict[str, Any]:
    """Return an item with a place; yaw is clockwise from north in MAVLink, counter-clockwise from east here."""
    x, y, z = (p - h for p, h in zip(pose.position_m, config.flight.home_m))
    yaw_deg = (90.0 - math.degrees(pose.heading_rad)) % 360.0
    latitude_deg, longitude_deg = home.place(x, y)
    return {
        "command": command,
        "frame": GLOBAL_RELATIVE_ALTITUDE,
        "Altitude": z,
        "AltitudeMode": 1,
        "params": [*first, yaw_deg, latitude_deg, longitude_deg, z],
    }


# What pages read of a mission's run directory.


@dataclass(frozen=True)
class FlightRecord:
    samples: Floats  # (N, 4): time in s; east, north and up in m
    ends_s: dict[str, float]  # by event, such as ``seed_03``, ``cand_017`` and ``return``, in their order
    duration_s: float

    def photographed_m(self) -> dict[str, Floats]:
        """(3,) by viewpoint's name: where the vehicle was when it photographed there, in the order flown."""
        last = len(self.samples) - 1
        return {
            name: self.samples[min(int(np.searchsorted(self.samples[:, 0], end_s)), last), 1:]
            for name, end_s in self.ends_s.items()
            if name.startswith(("seed_", "cand_"))
        }


def mission_config(run: Path) -> MissionConfig:
    """The configuration of a mission's directory; ``UserError`` if it is not there."""
    file = run / CONFIG
    if not file.is_file():
        raise UserError(f"{run} holds no {CONFIG}; name a directory that `gatetune mission run` wrote")
    return config_from_dict(read_yaml(file))


def planned_config(run: Path) -> MissionConfig:
    """The configuration that the mission planned with: with the target as the vehicle knew it."""
    return config_from_dict(read_yaml(run / LOCATED)) if (run / LOCATED).is_file() else mission_config(run)


def read_flight(run: Path) -> FlightRecord:
    """The flight of a mission; ``UserError`` if the mission kept nothing of it."""
    file = run / FLIGHT
    if not file.is_file():
        raise UserError(
            f"{run} holds no flight; name a mission that was run with all files kept (gatetune mission run, or --keep all)"
        )
    tree = read_json(file, RESULT_BYTES)
    try:
        samples = np.array([row[:4] for row in tree["samples"]], dtype=float).reshape(-1, 4)
        events = [(str(e["name"]), float(e["start_s"]), float(e["duration_s"])) for e in tree["events"]]
        ends = {name: start_s + duration_s for name, start_s, duration_s in events}
        return FlightRecord(samples, ends, float(tree["flight_time_s"]))
    except (KeyError, TypeError, ValueError, IndexError) as error:
        raise UserError(f"{file} is not a mission's flight; restore it") from error


def rock_of_mission(run: Path, result: MissionResult, rock: str | None, store: Store) -> Rock:
    """The rock that the mission in ``run`` was run on; ``UserError`` if the one found is another.

    ``rock``: catalogue name or mesh file, for a rock that is not in the catalogue under the mission's name for it.
    """
    name, remedy = rock or result.rock, "name its mesh file with --rock"
    try:
        loaded = mission_kind(result.provenance.get("fidelity", "")).load_rock(name, store)
    except UserError as error:
        if rock is not None:
            raise
        raise UserError(f"{run} was run on {name!r}, which the catalogue does not have; {remedy}") from error
    if loaded.sha256 != result.provenance.get("rock_sha256", loaded.sha256):
        raise UserError(f"{run} was run on another {name!r} than the one found now; {remedy}")
    return loaded


def thin_indices(total: int, count: int) -> np.ndarray:
    """At most ``count`` indices of ``range(total)``: a fixed random choice, in order."""
    if total <= count:
        return np.arange(total)
    return np.sort(np.random.default_rng(0).permutation(total)[:count])
