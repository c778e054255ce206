"""Our scorers and gates as one of theirs: the scorer ``gatetune`` of their ``SCORER_REGISTRY``.

Theirs are looked up by name and made from the ``scorer`` block of ``scoring.yaml``; they rank what their controller has
filtered. Every parameter of ours that scores or switches works there so, weights of each scorer and occlusion included.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, MutableMapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from nbv.config import MissionConfig, config_from_dict
from nbv.errors import UserError
from nbv.gates import make_gate
from nbv.geometry.frames import wrap_angle
from nbv.planner import density_d95_m
from nbv.safe_files import expanded, read_yaml
from nbv.scorers import rank_candidates
from nbv.types import CandidatePool, Floats, PlanningState
from tuner.bridges.photogrammetry_nbv.workspace import best_model, sparse_model

NAME = "gatetune"
CONFIG_VARIABLE = "GATETUNE_CONFIG"  # names a gatetune.yaml; so does ``scorer.gatetune_config``


def register(registry: MutableMapping[str, type], base: type, breakdown: type) -> None:
    """Put the scorer `NAME` into their registry.

    Parameters
    ----------
    registry
        ``photogrammetry_nbv.scorers.SCORER_REGISTRY``.
    base, breakdown
        ``BaseScorer`` and ``ScoreBreakdown``: our scorer is one of the former and answers with the latter.
    """

    def make(self: Any, config: Mapping[str, Any]) -> None:
        base.__init__(self, config)  # type: ignore[misc]
        self.planner = _Planner(load_config(config))

    def score(self: Any, candidates: Sequence[Any], sparse_metrics: Any, context: Any) -> list[Any]:
        return [breakdown(**entry) for entry in self.planner.rank(candidates, context)]

    registry[NAME] = type("GatetuneScorer", (base,), {"__init__": make, "score_candidates": score})


def load_config(scorer: Mapping[str, Any]) -> MissionConfig:
    """The configuration that the ``scorer`` block, or the environment, names.

    Raises
    ------
    UserError
        None is named, or it cannot be read.
    """
    name = scorer.get("gatetune_config") or os.environ.get(CONFIG_VARIABLE)
    if not name:
        raise UserError(f"name a gatetune.yaml: scorer.gatetune_config in scoring.yaml, or {CONFIG_VARIABLE}")
    try:
        tree = read_yaml(expanded(name))
    except UserError as error:
        raise UserError(f"{name} cannot be read: {error}") from error
    return config_from_dict(tree)


class _Planner:
    """From their candidates and context to a ranking of ours."""

    def __init__(self, config: MissionConfig) -> None:
        self._config, self._gate = config, make_gate(config)

    def rank(self, candidates: Sequence[Any], context: Any) -> list[dict[str, Any]]:
        """Fields of a ``ScoreBreakdown`` for each candidate, best first."""
        state, pool = self._state(context), self._pool(candidates, context)
        decision = self._gate.decide(state, pool, rank_candidates(state, pool, self._config))
        ranking = decision.ranking
        return [
            {
                "candidate_id": pool.ids[i],
                "final_score": float(ranking.scores[i]),
                "terms": {name: float(term[i]) for name, term in ranking.terms.items()},
                "weights": {},
                "scorer_name": f"{NAME}:{ranking.scorer}",
            }
            for i in map(int, ranking.order)
        ]

    def _ours(self, north_east_down: Floats, context: Any) -> Floats:
        """(N, 3) from their frame into ours: east, north, up, the rock's centre at the target."""
        relative = north_east_down.reshape(-1, 3) - np.asarray(context.rock_center_xyz, dtype=float)
        turned: Floats = relative[:, [1, 0, 2]] * (1.0, 1.0, -1.0) + np.array(self._config.target_m)
        return turned

    def _pool(self, candidates: Sequence[Any], context: Any) -> CandidatePool:
        positions = self._ours(np.array([(c.x, c.y, c.z) for c in candidates], dtype=float), context)
        relative = positions - np.array(self._config.target_m)
        return CandidatePool(
            tuple(str(c.candidate_id) for c in candidates),
            positions,
            np.asarray(wrap_angle(math.pi / 2 - np.array([c.yaw for c in candidates], dtype=float))),
            np.degrees(np.arctan2(relative[:, 1], relative[:, 0])),
            np.degrees(np.array([c.elevation_rad for c in candidates], dtype=float)),
            tuple(str(c.extra.get("planner_band", "lateral")) for c in candidates),
        )

    def _state(self, context: Any) -> PlanningState:
        visited = context.visited_viewpoints
        there = np.array([[v["position_ned_m"][a] for a in "xyz"] for v in visited], dtype=float)
        positions = self._ours(there, context)
        named = {str(v.get("image_file", "")): p for v, p in zip(visited, positions)}
        model = sparse_model(best_model(Path(context.colmap_workspace)), named)
        return PlanningState(
            model=model,
            visited_m=positions,
            n_seeds=sum(v.get("source") == "seed" for v in visited),
            vehicle_position_m=self._ours(np.array(context.current_position_xyz, dtype=float), context)[0],
            vehicle_heading_rad=float(wrap_angle(math.pi / 2 - context.current_yaw_rad)),
            captures_used=context.images_used,
            adaptive_budget=context.image_budget,
            d95_m=density_d95_m(model, self._config),
            iteration=context.current_iteration,
        )
