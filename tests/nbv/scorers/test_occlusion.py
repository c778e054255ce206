"""The deployable occlusion test on a sphere, where visibility has a closed form."""

from __future__ import annotations

import numpy as np

from nbv.scorers import BoxPoints
from nbv.scorers.occlusion import unoccluded

CENTER, RADIUS = np.array([0.0, 0.0, 1.0]), 0.8


def sphere_and_ground(noise_m: float) -> BoxPoints:
    """Points on a sphere and on the ground, each observed by the cameras that truly see it."""
    rng = np.random.default_rng(3)
    n = rng.normal(size=(900, 3))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    ground = np.column_stack([rng.uniform(-2, 2, (900, 2)), np.zeros(900)])
    points = np.concatenate([CENTER + RADIUS * n, ground])
    a = np.deg2rad(np.arange(0, 360, 15))
    cameras = np.column_stack([4 * np.cos(a), 4 * np.sin(a), np.where(np.arange(24) % 2, 2.0, 3.5)])
    seen = true_visibility(points, cameras)
    keep = seen.sum(axis=1) >= 2
    points, seen = points[keep], seen[keep]
    offsets = np.concatenate([[0], np.cumsum(seen.sum(axis=1))])
    track = np.nonzero(seen)[1]
    points = points + noise_m * rng.normal(size=points.shape)
    return BoxPoints(points, np.zeros(len(points)), offsets, track, cameras)


def true_visibility(points: np.ndarray, cameras: np.ndarray) -> np.ndarray:
    d = cameras[None] - points[:, None]
    d /= np.linalg.norm(d, axis=2, keepdims=True)
    to_center = CENTER - points
    along = np.einsum("pcj,pj->pc", d, to_center)
    nearest = np.sqrt(np.maximum((to_center**2).sum(axis=1)[:, None] - along**2, 0))
    return (along <= 1e-9) | (nearest >= RADIUS - 1e-9)


def test_agrees_with_the_truth_on_a_sphere() -> None:
    box = sphere_and_ground(noise_m=0.004)
    a = np.deg2rad([10.0, 100.0, 190.0, 280.0])
    candidates = np.column_stack([3.4 * np.cos(a), 3.4 * np.sin(a), [1.4, 1.8, 2.6, 3.4]])
    truth = true_visibility(box.points_m, candidates)
    ours = unoccluded(np.ones_like(truth), box, candidates)
    on_sphere = box.points_m[:, 2] > 0.1
    # On the sphere, what is lost is its limb: grazing views beyond the incidence limit.
    for part, hit_rate, reject_rate in ((on_sphere, 0.82, 0.98), (~on_sphere, 0.97, 0.97)):
        assert ours[part][truth[part]].mean() > hit_rate
        assert (~ours[part])[~truth[part]].mean() > reject_rate


def test_few_points_fall_back_to_the_observing_direction() -> None:
    points = np.array([[0.0, 0, 1], [0.1, 0, 1]])
    cameras = np.array([[4.0, 0, 1], [4.0, 1, 1]])
    box = BoxPoints(points, np.zeros(2), np.array([0, 2, 4]), np.array([0, 1, 0, 1]), cameras)
    ours = unoccluded(np.ones((2, 2), dtype=bool), box, np.array([[3.5, 0.0, 1.0], [-3.5, 0.0, 1.0]]))
    assert ours.tolist() == [[True, False], [True, False]]
