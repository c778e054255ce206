import numpy as np
import pytest

from nbv.geometry.knn import knn_statistics


def grid(n, spacing_m):
    return spacing_m * np.stack(np.meshgrid(*[np.arange(n)] * 3), axis=-1).reshape(-1, 3)


def test_cubic_grid():
    """Inside and on faces 5 neighbours are at one spacing; on the 12 edges the 5th is at sqrt(2)."""
    n, spacing = 20, 0.1
    edges = 12 * (n - 2) + 8
    statistics = knn_statistics(grid(n, spacing))
    assert statistics.mean_m == pytest.approx(spacing * (n**3 - edges + edges * np.sqrt(2)) / n**3)
    assert statistics.d95_m == pytest.approx(spacing)


def test_the_point_itself_is_not_its_neighbour():
    line = np.c_[np.arange(2.0), np.zeros(2), np.zeros(2)]
    assert knn_statistics(line, k=1).mean_m == pytest.approx(1.0)


def test_too_few_points_have_not_converged():
    for count in (0, 5):
        statistics = knn_statistics(np.zeros((count, 3)))
        assert np.isinf(statistics.d95_m) and np.isinf(statistics.mean_m)
    assert np.isfinite(knn_statistics(np.zeros((6, 3))).d95_m)


def test_the_box_keeps_only_points_near_the_target():
    near = grid(8, 0.1) + np.array([-0.35, -0.35, 0.45])
    far = np.random.default_rng(0).uniform(5, 50, (400, 3))
    cloud = np.concatenate([near, far])
    assert knn_statistics(cloud).d95_m > 1.0
    assert knn_statistics(cloud, region="box") == knn_statistics(near)


def test_scales_with_the_cloud():
    points = np.random.default_rng(1).uniform(0, 1, (300, 3))
    assert knn_statistics(3 * points).d95_m == pytest.approx(3 * knn_statistics(points).d95_m)
