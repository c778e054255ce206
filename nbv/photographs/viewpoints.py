"""Where a mission over photographs may look from: only where one was taken.

Seeds are the photographs nearest, by direction from the object, to the viewpoints that the configuration asks for, each
taken once; the pool is the photographs that are not taken yet. Planner, scorers and gates see their real positions.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist

from nbv.config import MissionConfig
from nbv.errors import MissionFailure
from nbv.geometry.frames import angles_deg, azimuths_elevations_deg, heading_to, unit_vectors
from nbv.random_streams import keyed_rng
from nbv.types import CandidatePool, Floats, Ints, Viewpoint
from nbv.viewpoints import ViewpointSource, seed_viewpoints

SEED_CAP_DEG = 20.0  # a seed viewpoint without a photograph within this is left out
MOST_MISSING = 0.25  # of the seeds; more, and the set cannot express the layout
UPPER_BAND_DEG = 35.0  # as in the paper's pool


class PhotographViewpoints(ViewpointSource):
    """The photographs of a set, taken at ``positions_m`` (N, 3) about the target of the configuration.

    ``ordered`` is the configuration as asked for: elevations are counted about its target. ``key`` and ``replicate`` draw by how
    much the seed layout is turned about the object; replicate 0 begins where the configuration says.
    """

    follows_target = False  # what was photographed, and from where, is known

    def __init__(
        self, positions_m: Floats, target_m: Sequence[float], ordered: MissionConfig, key: str, replicate: int
    ) -> None:
        self.positions_m = np.asarray(positions_m, dtype=float).reshape(-1, 3)
        offset = self.positions_m - np.asarray(target_m)
        self.directions = offset / np.linalg.norm(offset, axis=1, keepdims=True)
        self.azimuths_deg, self.elevations_deg = azimuths_elevations_deg(offset)
        self.turn_deg = (
            float(keyed_rng("photographs-turn", key, replicate).uniform(0.0, 360.0)) if replicate else 0.0
        )
        pool, centre_m = ordered.pool, ordered.target_m[2]
        self.lowest_deg, self.highest_deg = (
            float(np.rad2deg(np.arcsin(np.clip((altitude_m - centre_m) / pool.radius_m, -1.0, 1.0))))
            for altitude_m in (pool.min_altitude_m, pool.max_altitude_m)
        )
        self.highest_deg = min(self.highest_deg, pool.max_elevation_deg)

    def index(self, viewpoint: Viewpoint) -> int:
        return int(self.nearest(np.array([viewpoint.position_m]))[0])

    def nearest(self, positions_m: Floats) -> Ints:
        """(K,) which photographs were taken at (K, 3)."""
        return cdist(positions_m.reshape(-1, 3), self.positions_m).argmin(axis=1)

    def seeds(self, config: MissionConfig) -> Sequence[Viewpoint]:
        """The nearest photographs to the seed viewpoints turned by ``turn_deg``: the assignment with the least sum of squared angles.

        `MissionFailure` ``not_photographed`` where the set has too few photographs, none near more than a quarter of the viewpoints,
        or hardly any within the altitudes of the pool.
        """
        self._require_candidates(config)
        return self._nearest_to(seed_viewpoints(config))

    def _nearest_to(self, wanted: Sequence[Viewpoint]) -> list[Viewpoint]:
        if len(wanted) > len(self.positions_m):
            raise MissionFailure(
                "not_photographed",
                f"the configuration has {len(wanted)} seeds, and {len(self.positions_m)} photographs may be taken; "
                "lower seed.count",
            )
        azimuth_deg, elevation_deg = np.array([(v.azimuth_deg, v.elevation_deg) for v in wanted]).T
        angle_deg = angles_deg(unit_vectors(azimuth_deg - self.turn_deg, elevation_deg), self.directions)
        rows, columns = linear_sum_assignment(angle_deg**2)
        near = angle_deg[rows, columns] <= SEED_CAP_DEG
        if near.sum() < max(3, (1.0 - MOST_MISSING) * len(wanted)):
            raise MissionFailure(
                "not_photographed",
                f"only {near.sum()} of the {len(wanted)} seeds have a photograph within {SEED_CAP_DEG:g} degrees: "
                f"they ask for elevations of {elevation_deg.min():.0f} to {elevation_deg.max():.0f} "
                f"degrees, and the photographs have {self.elevations_deg.min():.0f} to "
                f"{self.elevations_deg.max():.0f}; set seed.lowest_deg and seed.span_deg (or seed.ring_elevations_deg)",
            )
        seeds = []
        for number, column in enumerate(columns[near].tolist()):
            x, y, z = self.positions_m[column].tolist()
            angles = float(self.azimuths_deg[column]), float(self.elevations_deg[column])
            seeds.append(Viewpoint(f"seed_{number:02d}", (x, y, z), *angles, "seed"))
        return seeds

    def _require_candidates(self, config: MissionConfig) -> None:
        allowed = int(self.within_altitudes.sum())
        if not config.adaptive_budget or allowed >= min(
            config.seed.total + config.adaptive_budget, len(self.positions_m) / 4
        ):
            return
        elevations_deg = np.sort(self.elevations_deg)
        raise MissionFailure(
            "not_photographed",
            f"pool.min_altitude_m {config.pool.min_altitude_m:g} and pool.max_altitude_m {config.pool.max_altitude_m:g} "
            f"are elevations of {self.lowest_deg:.0f} to {self.highest_deg:.0f} degrees about the object, "
            f"where there are {allowed} photographs to choose from: half of all photographs lie between "
            f"{elevations_deg[len(elevations_deg) // 4]:.0f} and {elevations_deg[3 * len(elevations_deg) // 4]:.0f} "
            "degrees; widen them",
        )

    def candidates(
        self, config: MissionConfig, vehicle_position_m: Floats, visited_m: Floats, n_seeds: int
    ) -> CandidatePool:
        """The photographs not taken yet, between the elevations that ``pool.min_altitude_m`` and ``max_altitude_m`` mean in the paper's pool."""
        left = np.ones(len(self.positions_m), dtype=bool)
        counts = {"raw": len(left)}
        if len(visited_m):
            left[self.nearest(visited_m)] = False
        counts["revisit"] = int(left.sum())
        keep = np.flatnonzero(left & self.within_altitudes)
        counts["altitude_travel"] = len(keep)
        positions = self.positions_m[keep]
        return CandidatePool(
            ids=tuple(f"cand_{i:03d}" for i in keep.tolist()),
            positions_m=positions,
            headings_rad=heading_to(positions, np.array(config.target_m)),
            azimuths_deg=self.azimuths_deg[keep],
            elevations_deg=self.elevations_deg[keep],
            bands=tuple(np.where(self.elevations_deg[keep] > UPPER_BAND_DEG, "upper", "lateral").tolist()),
            counts=counts,
        )

    @property
    def within_altitudes(self) -> NDArray[np.bool_]:
        """(N,) which photographs the altitude limits of the pool allow."""
        return (self.elevations_deg >= self.lowest_deg) & (self.elevations_deg <= self.highest_deg)
