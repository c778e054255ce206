"""Frontiers by density, after the surface edge explorer of Border, Gammell and Newman (ICRA 2018).

A sparse point is core where enough points lie within a radius, else an outlier; core points with an outlier near them are
frontier points: the surface ends there. The paper proposes views that look at a frontier along its normal. Here views stand in
the pool, so that a candidate's score is how squarely it looks at the frontier points in its image. Differences from the paper:
the points are those of the sparse model, with a radius that follows their spacing, and normals are from nearest neighbours.
"""

from dataclasses import dataclass, field

import numpy as np
from scipy.spatial import cKDTree

from nbv.config import MissionConfig, Weights
from nbv.config.declaration import Positive, Section, Share, not_in_paper
from nbv.scorers import Scorer, SharedTerms
from nbv.types import CandidatePool


@dataclass(frozen=True)
class Settings(Section):
    """Read as ``config.frontier_density``."""

    spacings: Positive = not_in_paper(4.0, "radius in median spacings of the points")
    core_share: Share = not_in_paper(
        0.5, "share of the median number of neighbours from which a point is core"
    )
    weights: Weights = field(default_factory=lambda: Weights(main=1.0, nov=0.5, move=0.0, ang=0.4))


def frontier(points_m: np.ndarray, settings: Settings) -> tuple[np.ndarray, np.ndarray]:
    """(F,) indices of the frontier points of (P, 3) points, and (F, 3) normals up to their sign."""
    tree = cKDTree(points_m)
    radius_m = settings.spacings * float(np.median(tree.query(points_m, k=2)[0][:, 1]))
    near = tree.query_ball_point(points_m, radius_m)
    count = np.array([len(own) for own in near])
    core = count >= settings.core_share * np.median(count)
    found = np.array([core[i] and not core[near[i]].all() for i in range(len(points_m))])
    chosen = np.flatnonzero(found)
    own = points_m[tree.query(points_m[chosen], k=min(10, len(points_m)))[1]]
    normals = np.linalg.eigh(np.einsum("fki,fkj->fij", *(2 * [own - own.mean(axis=1, keepdims=True)])))[1][
        :, :, 0
    ]
    return chosen, normals


def squareness(terms: SharedTerms, pool: CandidatePool, config: MissionConfig) -> np.ndarray:
    """(C,) mean cosine between a candidate's view and the normals of the frontier points, 0 for those it does not see."""
    points_m = terms.box.points_m
    if len(points_m) < 20:
        return np.zeros(len(pool))
    chosen, normals = frontier(points_m, config.frontier_density)
    if len(chosen) == 0:
        return np.zeros(len(pool))
    outward = points_m[chosen] - np.array(config.target_m)
    normals = normals * np.where(np.einsum("fi,fi->f", normals, outward) < 0, -1.0, 1.0)[:, None]
    to_view = pool.positions_m[None] - points_m[chosen][:, None]
    to_view /= np.linalg.norm(to_view, axis=2, keepdims=True)
    cosine = np.einsum("fci,fi->fc", to_view, normals)
    return (np.clip(cosine, 0.0, 1.0) * terms.visible[chosen]).mean(axis=0)


PLANNER = Scorer(
    "frontier-density", squareness, weights=lambda config: config.frontier_density.weights, settings=Settings
)
