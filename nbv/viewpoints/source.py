"""Where a mission may take its photographs: on rings about the target, or what another source offers instead."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from nbv.config import MissionConfig
from nbv.types import CandidatePool, Floats, Viewpoint
from nbv.viewpoints.pool import candidate_pool
from nbv.viewpoints.rings import second_turn_viewpoints, seed_viewpoints


class ViewpointSource(Protocol):
    """What the mission loop and the planner ask for viewpoints."""

    @property
    def follows_target(self) -> bool:
        """Whether viewpoints move with the target when it is found elsewhere than believed; if not it is not looked for."""

    def seeds(self, config: MissionConfig) -> Sequence[Viewpoint]:
        """The seeds of Phase 1 in the order flown."""

    def second_turn(self, config: MissionConfig) -> Sequence[Viewpoint]:
        """Further seeds between these, for where these make no model."""

    def candidates(
        self, config: MissionConfig, vehicle_position_m: Floats, visited_m: Floats, n_seeds: int
    ) -> CandidatePool:
        """The feasible candidates of one iteration, in the order in which ties are broken; may be empty.

        Parameters
        ----------
        config
            Its ``pool``.
        vehicle_position_m
            (3,) where the vehicle is.
        visited_m
            (V, 3) commanded positions of all photographs so far, seeds first.
        n_seeds
            How many of them are seeds.
        """


class Rings:
    """The paper's: seed rings and the two-band pool, anywhere about the target."""

    follows_target = True

    def seeds(self, config: MissionConfig) -> Sequence[Viewpoint]:
        """See `nbv.viewpoints.seed_viewpoints`."""
        return seed_viewpoints(config)

    def second_turn(self, config: MissionConfig) -> Sequence[Viewpoint]:
        """See `nbv.viewpoints.second_turn_viewpoints`."""
        return second_turn_viewpoints(config)

    def candidates(
        self, config: MissionConfig, vehicle_position_m: Floats, visited_m: Floats, n_seeds: int
    ) -> CandidatePool:
        """See `nbv.viewpoints.candidate_pool`.

        Parameters
        ----------
        config, vehicle_position_m, visited_m, n_seeds
            As in `ViewpointSource.candidates`.
        """
        return candidate_pool(config, vehicle_position_m, visited_m[n_seeds:])


RINGS = Rings()
