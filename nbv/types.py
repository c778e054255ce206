"""The values that pass between the packages of a mission. Arrays only: no files, no COLMAP, no meshes."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Floats32 = NDArray[np.float32]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]
Point = tuple[float, float, float]  # x, y, z in metres


@dataclass(frozen=True)
class Viewpoint:
    """A commanded camera position (world frame, ENU, metres); the gimbal aims at the target from it."""

    id: str  # "seed_00" ... or "cand_000" ...; the same id is the same place in every mission
    position_m: Point
    azimuth_deg: float  # of the viewpoint seen from the target, counter-clockwise from east
    elevation_deg: float
    band: str  # "seed", "ring", "lateral" or "upper"


@dataclass(frozen=True)
class Capture:
    """One photograph and where telemetry says that it was taken from."""

    name: str  # image file name, unique within the mission, e.g. "seed_00.png" or "cand_017.png"
    viewpoint: Viewpoint
    camera_from_world: Floats  # (4, 4) rigid, OpenCV axes (x right, y down, z forward)
    image: NDArray[np.uint8] | None  # (H, W, 3) RGB; None in the geometric fidelity


@dataclass(frozen=True)
class SparseModel:
    """What a planner may see. Nothing from the ground truth is reachable from here.

    Tracks are in CSR form: the cameras that observe point ``i`` are
    ``track_cameras[track_offsets[i]:track_offsets[i + 1]]``, indices into ``camera_centers_m``.
    """

    points_m: Floats  # (N, 3) world frame
    reprojection_error_px: Floats  # (N,)
    track_offsets: Ints  # (N + 1,)
    track_cameras: Ints  # (T,)
    camera_centers_m: Floats  # (M, 3) registered cameras, world frame
    camera_names: tuple[str, ...]  # (M,) capture names
    alignment_rms_m: float  # residual of the similarity alignment over the registered cameras
    alignment_max_m: float
    # Coarse depth, where the vehicle has computed some: places (K, 3), and the cameras (K,) whose depth they are.
    depth_m: Floats = field(default_factory=lambda: np.zeros((0, 3)))
    depth_cameras: Ints = field(default_factory=lambda: np.zeros(0, dtype=np.int64))

    @property
    def track_lengths(self) -> Ints:
        """(N,) number of cameras per point."""
        return np.diff(self.track_offsets)

    def select(self, keep: Ints) -> SparseModel:
        """The model of the points ``keep`` (K,), in that order, and of all cameras."""
        if len(keep) == len(self.points_m) and (np.diff(keep) > 0).all():
            return self
        lengths = self.track_lengths[keep]
        offsets = np.concatenate([[0], np.cumsum(lengths)]).astype(np.int64)
        # Position of every kept observation in the full list: start of its point's track + rank within it.
        observation = np.arange(offsets[-1]) + np.repeat(self.track_offsets[keep] - offsets[:-1], lengths)
        return replace(
            self,
            points_m=self.points_m[keep],
            reprojection_error_px=self.reprojection_error_px[keep],
            track_offsets=offsets,
            track_cameras=self.track_cameras[observation],
        )


@dataclass(frozen=True)
class UpdateReport:
    model: SparseModel
    registered: bool
    message: str = ""  # why not, or what was noticed (e.g. the alignment residual)


@dataclass(frozen=True)
class PointCloud:
    """Dense points in the world frame."""

    points_m: Floats  # (N, 3)
    colors: NDArray[np.uint8] | None = None  # (N, 3) RGB
    normals: Floats | None = None  # (N, 3)

    def __len__(self) -> int:
        return len(self.points_m)


class LazyCloud:
    """A point cloud that is made when its points are first asked for.

    Its attributes are those of `PointCloud`. A cloud takes 10 to 30 MB, its metrics 4 kB; so only the metrics are kept,
    and a mission whose metrics are known never makes its cloud. ``make`` is called at most once and may raise
    `MissionFailure`.
    """

    def __init__(self, make: Callable[[], PointCloud]) -> None:
        self._make = functools.cache(make)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._make(), name)


Cloud = PointCloud | LazyCloud


@dataclass(frozen=True)
class CandidatePool:
    """Feasible candidates in the order in which ties are broken."""

    ids: tuple[str, ...]  # (C,)
    positions_m: Floats  # (C, 3)
    headings_rad: Floats  # (C,) vehicle heading that faces the target, counter-clockwise from east
    azimuths_deg: Floats  # (C,)
    elevations_deg: Floats  # (C,)
    bands: tuple[str, ...]  # (C,)
    counts: dict[str, int] = field(default_factory=dict)  # survivors after each filter, by name

    def __len__(self) -> int:
        return len(self.ids)

    def viewpoint(self, index: int) -> Viewpoint:
        x, y, z = (float(v) for v in self.positions_m[index])
        return Viewpoint(
            self.ids[index],
            (x, y, z),
            float(self.azimuths_deg[index]),
            float(self.elevations_deg[index]),
            self.bands[index],
        )


@dataclass(frozen=True)
class PlanningState:
    """Everything a scorer, gate or filter may use at one iteration (arrays in, ranking out)."""

    model: SparseModel
    visited_m: Floats  # (V, 3) commanded positions of all captures so far, seeds first
    n_seeds: int
    vehicle_position_m: Floats  # (3,) where the vehicle estimates to be
    vehicle_heading_rad: float
    captures_used: int  # planned views so far
    planned_views: int  # of the mission, at most
    d95_m: float  # 95th-percentile KNN distance of the sparse cloud
    iteration: int


@dataclass(frozen=True)
class Ranking:
    """One scorer's complete ranking of a pool."""

    scorer: str  # "covis", "b-aware", ...
    order: Ints  # (C,) candidate indices, best first; ties keep pool order
    scores: Floats  # (C,) S(c), in pool order
    terms: dict[str, Floats]  # (C,) each, unweighted: "main", "nov", "move", "ang"

    @property
    def top(self) -> int:
        return int(self.order[0])


@dataclass(frozen=True)
class GateDecision:
    """Which ranking is used, and why."""

    ranking: Ranking  # one of the inputs, unchanged (hard switch)
    reason: str
    details: dict[str, Any] = field(default_factory=dict)  # e.g. f_b, d95_m, oracle rewards


class Camera:
    """Takes the photographs of one mission. The mission loop does not know which implementation it has."""

    def take_photograph(self, viewpoint: Viewpoint, position_m: Floats, time_s: float) -> Capture:
        """The photograph of ``viewpoint``, taken where the vehicle estimates to be, ``position_m`` (3,).

        ``time_s`` into the flight, on which slow errors of the telemetry depend.
        """
        raise NotImplementedError

    def __init__(self, target_m: Point) -> None:
        self.target_m = target_m

    def aim_at(self, target_m: Point) -> None:
        """From now on: the target has been found there."""
        self.target_m = target_m

    def close(self) -> None:
        """Free memory; called after the last photograph."""


class Reconstructor:
    """Turns captures into models. The mission loop does not know which implementation it has."""

    def bootstrap(self, captures: Sequence[Capture]) -> UpdateReport:
        """Build the seed model; raises ``MissionFailure`` if there is none."""
        raise NotImplementedError

    def partial_model(self, captures: Sequence[Capture]) -> SparseModel | None:
        """The model of the first few seeds alone, None if there is none; later models do not contain it."""
        return None

    def add(self, capture: Capture) -> UpdateReport:
        """Update the model with one more capture; an unregistered image is reported, not raised."""
        raise NotImplementedError

    def recentre(self, target_m: Point, half_width_m: float) -> None:
        """From now on: the target has been found there, in a cube of twice ``half_width_m``."""

    def finish(self) -> Cloud:
        """Dense reconstruction in the world frame; raises ``MissionFailure`` if nothing fuses."""
        raise NotImplementedError
