"""The reordered query returns what a plain one returns; the spacing of a cloud; views that could match, counted plainly."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nbv.config import MissionConfig
from nbv.geometry.matchability import matchable_views, matchable_views_with, partners
from nbv.geometry.neighbours import knn_d95_m

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


def plainly(pairs: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """(S,) size of the largest group of a view that sees the sample and those that it matches there."""
    groups = [
        [
            1 + sum(pairs[s, v, u] and seen[s, u] for u in range(seen.shape[1]))
            for v in np.flatnonzero(seen[s])
        ]
        for s in range(len(seen))
    ]
    return np.array([max(group, default=0) for group in groups])


@settings(max_examples=50)
@given(seed=st.integers(0, 10_000), n_views=st.integers(0, 6), n_samples=st.integers(1, 5))
def test_one_view_more_counts_as_if_it_had_been_there_all_along(
    seed: int, n_views: int, n_samples: int
) -> None:
    rng = np.random.default_rng(seed)
    seen = rng.random((n_samples, n_views + 1)) < 0.7
    pairs = rng.random((n_samples, n_views + 1, n_views + 1)) < 0.6
    pairs |= pairs.transpose(0, 2, 1)
    pairs &= ~np.eye(n_views + 1, dtype=bool)
    have = partners(pairs[:, :-1, :-1], seen[:, :-1])
    np.testing.assert_array_equal(matchable_views(have), plainly(pairs[:, :-1, :-1], seen[:, :-1]))
    new = pairs[:, -1:, :-1] & seen[:, -1:, None] & seen[:, None, :-1]
    after = matchable_views_with(have, new, seen[:, -1:])[:, 0]
    np.testing.assert_array_equal(after, plainly(pairs, seen))
