"""Streams depend on their key alone."""

import pytest

from nbv.process import keyed_rng


def test_streams_are_pinned():
    """A change here would silently change every photograph ever taken."""
    assert keyed_rng("noise", "0" * 64, 0, "seed_00").integers(0, 2**32, 3).tolist() == PINNED


@pytest.mark.parametrize("part", [1.0, None, True, b"x"])
def test_other_types_are_refused(part):
    with pytest.raises(TypeError, match="strings and integers"):
        keyed_rng("a", part)


PINNED = [1829865842, 3820967078, 1671959790]
