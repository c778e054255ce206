"""The spacing of a cloud, d95: over all points, or over those near the target."""

import numpy as np
import pytest

from nbv.config import MissionConfig
from nbv.geometry.visibility import knn_d95_m

ALL = MissionConfig()


def grid(n, spacing_m):
    return spacing_m * np.stack(np.meshgrid(*[np.arange(n)] * 3), axis=-1).reshape(-1, 3)


def test_the_fifth_neighbour_of_a_cubic_grid():
    """Inside and on faces 5 neighbours are at one spacing; only on the 12 edges the 5th is farther."""
    assert knn_d95_m(grid(20, 0.1), ALL) == pytest.approx(0.1)


def test_too_few_points_have_not_converged():
    assert [np.isinf(knn_d95_m(np.zeros((count, 3)), ALL)) for count in (0, 5, 6)] == [True, True, False]


def test_the_box_keeps_only_points_near_the_target():
    near = grid(8, 0.1) + np.array([-0.35, -0.35, 0.45])
    far = np.random.default_rng(0).uniform(5, 50, (400, 3))
    cloud = np.concatenate([near, far])
    assert knn_d95_m(cloud, ALL) > 1.0
    assert knn_d95_m(cloud, ALL.changed(stop={"knn_region": "box"})) == knn_d95_m(near, ALL)
