"""Fisher information of the sparse model, after Lim, Lawrance, Achtelik and Beltrame (ICRA 2023).

A photograph of a point adds J^T J / sigma^2 to the information about the point's place, J the derivative of its image with
respect to it; cameras are taken as known. The score of a candidate is by how much it would lower the uncertainty of the points
in its image: the mean logarithm of the ratio of determinants after and before (D-optimality). Differences from the paper: the
views stand in the pool, and only points are uncertain, not poses.
"""

from dataclasses import dataclass, field

import numpy as np

from nbv.config import MissionConfig, Weights
from nbv.config.declaration import Positive, Section, not_in_paper
from nbv.scorers import Scorer, SharedTerms
from nbv.types import CandidatePool


@dataclass(frozen=True)
class Settings(Section):
    """Read as ``config.fisher_information``."""

    max_incidence_deg: Positive = not_in_paper(
        60.0, "a point is not seen from farther off its mean observed direction"
    )
    sigma_px: Positive = not_in_paper(1.0, "error of a feature's place in the image")
    weights: Weights = field(default_factory=lambda: Weights(main=1.0, nov=0.0, move=0.0, ang=0.0))


def information(points_m: np.ndarray, views_m: np.ndarray, focal_px: float, sigma_px: Positive) -> np.ndarray:
    """(N, 3, 3) what a view (N, 3) aimed at a point (N, 3) says of it: nothing along its ray, (f / d sigma)^2 across."""
    ray = points_m - views_m
    squared = np.einsum("ni,ni->n", ray, ray)
    across = np.eye(3) - np.einsum("ni,nj->nij", ray, ray) / squared[:, None, None]
    return across * (focal_px**2 / (squared * sigma_px**2))[:, None, None]


def gain(terms: SharedTerms, pool: CandidatePool, config: MissionConfig) -> np.ndarray:
    """(C,) gain of each candidate, over the largest."""
    settings, box, focal_px = config.fisher_information, terms.box, config.camera.focal_px
    point = np.repeat(np.arange(len(box.points_m)), box.track_lengths)
    cameras_m = box.camera_centers_m[box.track_cameras]
    known = np.zeros((len(box.points_m), 3, 3))
    np.add.at(known, point, information(box.points_m[point], cameras_m, focal_px, settings.sigma_px))
    inverse = np.linalg.inv(known + 1e-3 * np.eye(3))
    mean = np.zeros((len(box.points_m), 3))
    toward = cameras_m - box.points_m[point]
    np.add.at(mean, point, toward / np.linalg.norm(toward, axis=1, keepdims=True))
    mean /= np.maximum(np.linalg.norm(mean, axis=1, keepdims=True), 1e-12)
    least = np.cos(np.deg2rad(settings.max_incidence_deg))
    scores = np.zeros(len(pool))
    for c, view_m in enumerate(pool.positions_m):
        ray = box.points_m - view_m
        squared = np.einsum("pi,pi->p", ray, ray)
        ray = ray / np.sqrt(squared)[:, None]
        seen = terms.visible[:, c] & (-np.einsum("pi,pi->p", ray, mean) > least)
        # det(A + k (I - r r^T)) / det(A) through the 2 x 2 block across the ray.
        side = np.cross(ray[seen], [0.3, 0.5, 0.8])
        side /= np.linalg.norm(side, axis=1, keepdims=True)
        basis = np.stack([side, np.cross(ray[seen], side)], axis=1)
        block = np.einsum("pai,pij,pbj->pab", basis, inverse[seen], basis)
        block *= (focal_px**2 / (squared[seen] * settings.sigma_px**2))[:, None, None]
        scores[c] = np.log(np.linalg.det(np.eye(2) + block)).sum()
    return scores / max(float(scores.max()), 1e-12)


PLANNER = Scorer(
    "fisher-information", gain, weights=lambda config: config.fisher_information.weights, settings=Settings
)
