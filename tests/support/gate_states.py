"""States, pools and rankings for the gate tests."""

import numpy as np
from scoring_state import sparse_model

from nbv.config import MissionConfig
from nbv.types import CandidatePool, PlanningState, Ranking
from nbv.viewpoints import RINGS, seed_viewpoints


def state(
    points: np.ndarray | None = None, used: int = 0, d95_m: float = 0.1, visited: np.ndarray | None = None
) -> PlanningState:
    """After the seeds and ``used`` planned views of 40; two seeds see every point."""
    if points is None:
        points = np.random.default_rng(0).uniform(-0.6, 0.6, (50, 3)) + np.array([0, 0, 0.8])
    seeds = np.array([s.position_m for s in seed_viewpoints(MissionConfig())])
    model = sparse_model(points, [np.arange(2)] * len(points), seeds, np.linspace(0.1, 0.9, len(points)))
    visited = seeds if visited is None else visited
    return PlanningState(model, visited, 24, np.array([0.0, -4.0, 2.0]), 1.5, used, 40, d95_m, used)


def pool() -> CandidatePool:
    return RINGS.candidates(MissionConfig(), np.array([0.0, -4.0, 2.0]), np.zeros((0, 3)), 0)


def rankings(covis_top: int, b_aware_top: int, n: int) -> dict[str, Ranking]:
    """Of ``n`` candidates each scorer likes one, and all others equally little."""
    found = {}
    for name, top in (("covis", covis_top), ("b-aware", b_aware_top)):
        scores = np.eye(n)[top]
        move = np.linspace(1, 0.5, n) ** 2
        terms = {"main": scores, "nov": np.linspace(0, 1, n), "move": move, "ang": np.zeros(n)}
        found[name] = Ranking(name, np.argsort(-scores, kind="stable"), scores, terms)
    return found
