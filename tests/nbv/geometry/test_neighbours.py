"""The reordered query returns what a plain one returns."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from nbv.geometry.neighbours import nearest_neighbours


@pytest.mark.parametrize("k", [1, 5])
def test_equals_a_plain_query(k):
    rng = np.random.default_rng(k)
    points, queries = rng.normal(size=(3000, 3)), rng.normal(size=(1000, 3))
    for asked in (queries, points):
        expected_distance, expected_index = cKDTree(points).query(asked, k=k)
        distance, index = nearest_neighbours(points, asked, k)
        assert np.array_equal(distance, expected_distance)
        assert np.array_equal(index, expected_index)  # no ties among random points
