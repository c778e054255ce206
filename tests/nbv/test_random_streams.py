"""Streams depend on their key alone."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nbv.random_streams import keyed_rng

parts = st.lists(st.one_of(st.text(max_size=8), st.integers(-(2**70), 2**70)), max_size=4)


@given(parts)
def test_equal_keys_give_equal_streams(key):
    first = keyed_rng(*key).standard_normal(4)
    keyed_rng("something else").standard_normal(1000)
    assert np.array_equal(first, keyed_rng(*key).standard_normal(4))


@given(parts, parts)
def test_different_keys_give_different_streams(a, b):
    if [(type(p), p) for p in a] != [(type(p), p) for p in b]:
        assert not np.array_equal(keyed_rng(*a).standard_normal(4), keyed_rng(*b).standard_normal(4))


def test_streams_are_pinned():
    """A change here would silently change every photograph ever taken."""
    assert keyed_rng("noise", "0" * 64, 0, "seed_00").integers(0, 2**32, 3).tolist() == PINNED


@pytest.mark.parametrize("part", [1.0, None, True, b"x"])
def test_other_types_are_refused(part):
    with pytest.raises(TypeError, match="strings and integers"):
        keyed_rng("a", part)


PINNED = [1829865842, 3820967078, 1671959790]
