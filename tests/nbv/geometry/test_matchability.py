"""Views that dense stereo could match, counted plainly."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from nbv.geometry.matchability import (
    matchable_views,
    matchable_views_with,
    partners,
)


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
