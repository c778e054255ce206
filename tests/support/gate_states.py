"""States, pools and rankings for the gate tests."""

import numpy as np
from scoring_state import sparse_model

from nbv.config import MissionConfig
from nbv.types import CandidatePool, PlanningState, Ranking, SparseModel
from nbv.viewpoints import candidate_pool, seed_viewpoints


def model(points: np.ndarray, lengths: np.ndarray | None = None, cameras: int = 24) -> SparseModel:
    lengths = np.full(len(points), 2) if lengths is None else lengths
    seeds = np.array([s.position_m for s in seed_viewpoints(MissionConfig())])[:cameras]
    return sparse_model(points, [np.arange(k) for k in lengths], seeds, np.linspace(0.1, 0.9, len(points)))


def state(
    points: np.ndarray | None = None,
    used: int = 0,
    budget: int = 40,
    d95_m: float = 0.1,
    visited: np.ndarray | None = None,
    lengths: np.ndarray | None = None,
) -> PlanningState:
    points = (
        np.random.default_rng(0).uniform(-0.6, 0.6, (50, 3)) + np.array([0, 0, 0.8])
        if points is None
        else points
    )
    seeds = np.array([s.position_m for s in seed_viewpoints(MissionConfig())])
    return PlanningState(
        model(points, lengths),
        seeds if visited is None else visited,
        24,
        np.array([0.0, -4.0, 2.0]),
        1.5,
        used,
        budget,
        d95_m,
        used,
    )


def pool() -> CandidatePool:
    return candidate_pool(MissionConfig(), np.array([0.0, -4.0, 2.0]), np.zeros((0, 3)))


def ranking(name: str, scores: np.ndarray) -> Ranking:
    terms = {
        "main": scores,
        "nov": np.linspace(0, 1, len(scores)),
        "move": np.linspace(1, 0.5, len(scores)) ** 2,
        "ang": np.zeros(len(scores)),
    }
    return Ranking(name, np.argsort(-scores, kind="stable"), scores, terms)


def rankings(covis_top: int, b_aware_top: int, n: int) -> dict[str, Ranking]:
    scores = {}
    for name, top in (("covis", covis_top), ("b-aware", b_aware_top)):
        s = np.zeros(n)
        s[top] = 1.0
        scores[name] = ranking(name, s)
    return scores
