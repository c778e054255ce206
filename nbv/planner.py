"""What a companion computer runs: candidates, scorers, gate and stop of Phase 2, and nothing that simulates.

Loads neither Open3D, pyrender nor torch. The mission loop plans with it, too.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from nbv.config import MissionConfig, config_from_dict
from nbv.errors import UserError
from nbv.gates import Gate, make_gate
from nbv.geometry.visibility import knn_d95_m
from nbv.safe_files import read_yaml
from nbv.scorers import Rankings
from nbv.scorers.prediction import predict
from nbv.types import CandidatePool, Floats, GateDecision, PlanningState, Ranking, SparseModel, Viewpoint
from nbv.viewpoints import RINGS, ViewpointSource


@dataclass(frozen=True)
class Plan:
    state: PlanningState
    converged: bool  # the cloud is dense enough, or the next view adds too little
    pool: CandidatePool
    rankings: dict[str, Ranking] = field(default_factory=dict)  # empty where there is no decision
    decision: GateDecision | None = None  # None where the phase ends
    end: str = ""  # why it ends: the budget is used, converged, or no candidate is left

    @property
    def next_view(self) -> Viewpoint | None:
        """Where to photograph next; None where the phase ends."""
        return None if self.decision is None else self.pool.viewpoint(self.decision.ranking.top)


class Planner:
    """Plans the next view of Phase 2 from what the vehicle knows.

    ``config`` is the tuned configuration; `Planner.from_yaml` reads one that ``gatetune export --to gatetune.yaml`` wrote. ``gate``: by
    default the one that the configuration names. ``viewpoints``: where the next view may be, by default in the paper's pool.
    `UserError` where the configuration names a gate that needs the ground truth.
    """

    def __init__(
        self, config: MissionConfig, gate: Gate | None = None, viewpoints: ViewpointSource = RINGS
    ) -> None:
        self.config = config
        self.viewpoints = viewpoints
        self.gate = gate if gate is not None else make_gate(config)

    @classmethod
    def from_yaml(cls, path: Path) -> Planner:
        """The planner that a YAML file of a whole configuration describes; ``UserError`` if it cannot be read."""
        tree = read_yaml(Path(path))
        if not isinstance(tree, dict):
            raise UserError(f"{path} holds no configuration; gatetune export --to gatetune.yaml writes one")
        return cls(config_from_dict(tree))

    def plan(
        self,
        model: SparseModel,
        visited_m: Floats,
        n_seeds: int,
        vehicle_position_m: Floats,
        vehicle_heading_rad: float,
    ) -> Plan:
        """Decide on the next view.

        `MissionFailure` ``no_points_in_box``: no tracked point near the target. `UserError` where a pose is not finite, or
        ``n_seeds`` is no number of the visited views.

        Parameters
        ----------
        model
            Sparse points, tracks and registered cameras, in metres, world frame (ENU, the target above the origin).
        visited_m
            (V, 3) commanded positions of all photographs so far, seeds first.
        n_seeds
            How many of them are seeds; the others have used the budget.
        vehicle_position_m, vehicle_heading_rad
            (3,) and counter-clockwise from east: the estimated pose of the vehicle.
        """
        visited = np.asarray(visited_m, dtype=float).reshape(-1, 3)
        stop = self.config.stop
        used = len(visited) - n_seeds
        if not 0 <= n_seeds <= len(visited):
            raise UserError(
                f"n_seeds {n_seeds} is not 0 to {len(visited)}, of the visited views; count the seeds"
            )
        if not np.isfinite([*visited.ravel(), *np.ravel(vehicle_position_m), vehicle_heading_rad]).all():
            raise UserError("a visited view or the vehicle's pose is not finite; plan once they are known")
        state = PlanningState(
            model=model,
            visited_m=visited,
            n_seeds=n_seeds,
            vehicle_position_m=np.asarray(vehicle_position_m, dtype=float),
            vehicle_heading_rad=vehicle_heading_rad,
            captures_used=used,
            planned_views=self.config.planned_views,
            d95_m=knn_d95_m(model.points_m, self.config),
            iteration=used,
        )
        pool = self.viewpoints.candidates(self.config, state.vehicle_position_m, visited, n_seeds)
        if used >= state.planned_views:
            return Plan(state, False, pool, end=f"the budget of {state.planned_views} is used")
        prediction, converged = None, False
        if stop.criterion == "both":
            converged = state.d95_m <= stop.knn_threshold_m
        elif stop.criterion == "predicted":
            prediction = predict(model, self.config)
            converged = prediction.f_score_percent >= stop.predicted_percent
        if converged or len(pool) == 0:
            return Plan(state, converged, pool, end="converged" if converged else "no candidate left")
        rankings = Rankings(state, pool, self.config, prediction)
        decision = self.gate.decide(state, pool, rankings)
        return Plan(state, False, pool, rankings, decision)
