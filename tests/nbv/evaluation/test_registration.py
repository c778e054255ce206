"""Registration against known offsets, and its two honest limits."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from nbv.evaluation.registration import register_cloud
from nbv.geometry.frames import Similarity


def bumpy_rock(count: int, seed: int, upper: bool = False) -> np.ndarray:
    """(N, 3) a bumpy ellipsoid without symmetry, 1.6 m tall, standing on z = 0; ``upper``: without its underside."""
    rng = np.random.default_rng(seed)
    d = rng.standard_normal((count, 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    bumps = 1 + 0.15 * np.sin(3 * d[:, 0] + 1) * np.cos(4 * d[:, 1]) + 0.1 * np.sin(5 * d[:, 2] + 2 * d[:, 0])
    points = d * bumps[:, None] * np.array([0.6, 0.7, 0.8]) + np.array([0.0, 0.0, 0.8])
    return points[d[:, 2] > -0.5] if upper else points


@pytest.mark.slow
@pytest.mark.parametrize(
    ("offset_m", "turn_deg", "scale"),
    [((0.3, -0.2, 0.1), 3.0, 1.02), ((0.0, 0.0, -0.4), 0.0, 1.0), ((0.05, 0.02, 0.0), 6.0, 0.97)],
)
def test_a_known_offset_is_found(offset_m: tuple[float, ...], turn_deg: float, scale: float) -> None:
    turn = Rotation.from_euler("xyz", [turn_deg, -turn_deg / 2, turn_deg], degrees=True).as_matrix()
    displaced = Similarity(scale, turn, np.array(offset_m))
    cloud = displaced.apply(bumpy_rock(15_000, seed=1, upper=True))
    found = register_cloud(cloud, bumpy_rock(20_000, seed=2))
    error_m = np.linalg.norm(found.apply(cloud) - bumpy_rock(15_000, seed=1, upper=True), axis=1)
    assert np.sqrt((error_m**2).mean()) < 0.004


def test_nothing_within_reach_stays_where_it_is() -> None:
    cloud = bumpy_rock(500, seed=1) + 50.0
    found = register_cloud(cloud, bumpy_rock(500, seed=2))
    np.testing.assert_array_equal(found.apply(cloud), cloud)
