"""States, pools and rankings for the gate tests."""

from __future__ import annotations

import numpy as np

from nbv.config import MissionConfig
from nbv.types import CandidatePool, PlanningState, Ranking, SparseModel
from nbv.viewpoints import candidate_pool, seed_viewpoints


def model(points: np.ndarray, lengths: np.ndarray | None = None, cameras: int = 24) -> SparseModel:
    lengths = np.full(len(points), 2) if lengths is None else lengths
    offsets = np.concatenate([[0], np.cumsum(lengths)]).astype(np.int64)
    track = np.concatenate([np.arange(k) for k in lengths]).astype(np.int64)
    seeds = np.array([s.position_m for s in seed_viewpoints(MissionConfig())])[:cameras]
    return SparseModel(
        points,
        np.linspace(0.1, 0.9, len(points)),
        offsets,
        track,
        seeds,
        tuple(f"seed_{i:02d}.png" for i in range(cameras)),
        0.004,
        0.02,
    )


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
