"""The 8-bit way gives what `nbv.sparse.matching.match_pair` gives, to the bit."""

import functools
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nbv.config import CameraConfig, SparseConfig
from nbv.sparse import eight_bit_matching
from nbv.sparse.correspondences import ComputedCorrespondences
from nbv.sparse.eight_bit_matching import (
    eight_bit_products_are_exact,
    match_pair_fast,
    nearest_in_8_bits,
)
from nbv.sparse.features import Features
from nbv.sparse.matching import match_pair, nearest_in_single_precision, verify_pair

match_pair_in_8_bits = functools.partial(match_pair, nearest=nearest_in_8_bits)

needs_8_bits = pytest.mark.skipif(
    not eight_bit_products_are_exact(), reason="this processor has no exact 8-bit dot products"
)


def descriptors(rng, count, spikes=0.0):
    """Bytes of norm 512; with ``spikes`` some of them above the largest int8."""
    raw = np.abs(rng.standard_normal((count, 128)))
    raw[rng.random(count) < spikes, 3] = 8.0
    raw /= np.linalg.norm(raw, axis=1, keepdims=True)
    return np.clip(np.round(512 * raw), 0, 255).astype(np.uint8)


def overlapping(seed, count_a, count_b, noise, spikes):
    rng = np.random.default_rng(seed)
    a, b = descriptors(rng, count_a, spikes), descriptors(rng, count_b, spikes)
    shared = min(count_a, count_b) // 2
    jitter = np.round(noise * 512 * rng.standard_normal((shared, 128)))
    b[:shared] = np.clip(a[:shared] + jitter, 0, 255)
    return a, b


@needs_8_bits
@settings(max_examples=60)
@given(
    st.integers(0, 10_000),
    st.integers(1, 90),
    st.integers(1, 90),
    st.floats(0.0, 0.05),
    st.sampled_from([0, 0.1, 1]),
)
def test_equals_single_precision(seed, count_a, count_b, noise, spikes):
    a, b = overlapping(seed, count_a, count_b, noise, spikes)
    for ratio, limit in ((0.8, 0.7), (0.95, 1.0), (1.0, 1.5)):
        expected = match_pair(a, b, ratio, limit)
        got = match_pair_in_8_bits(a, b, ratio, limit)
        assert got.dtype == expected.dtype
        np.testing.assert_array_equal(got, expected)


@needs_8_bits
def test_equals_single_precision_on_extreme_bytes_and_ties():
    rng = np.random.default_rng(5)
    a = rng.choice(np.array([0, 126, 127, 128, 255], np.uint8), (70, 128))
    b = np.concatenate([a[::-1], a[:20]])  # every product of a row with itself is found twice by 20 rows
    for x, y in ((a, b), (b, a), (a, a), (a[:1], a[:1]), (np.full_like(a, 255), a)):
        np.testing.assert_array_equal(match_pair_in_8_bits(x, y, 1.0, 3.0), match_pair(x, y, 1.0, 3.0))


@needs_8_bits
@settings(max_examples=60)
@given(st.integers(0, 10_000), st.integers(1, 40), st.integers(1, 40), st.sampled_from([0, 0.3, 1]))
def test_the_two_nearest_are_the_same_as_in_single_precision(seed, count_a, count_b, large):
    """Also for rows that no match comes from: few values, so nearly all rows have ties, and products of zero."""
    rng = np.random.default_rng(seed)
    a, b = (rng.choice(np.array([0, 0, 0, 0, 0, 0, 1, 127], np.uint8), (n, 128)) for n in (count_a, count_b))
    for x in (a, b):
        x[rng.random(len(x)) < 0.3] = 0
        x[rng.random(len(x)) < large, 5] = rng.choice([128, 255])
    b[rng.integers(count_b)] = b[rng.integers(count_b)]
    for got, expected in zip(nearest_in_8_bits(a, b), nearest_in_single_precision(a, b), strict=True):
        assert got.dtype == expected.dtype
        np.testing.assert_array_equal(got, expected)


@needs_8_bits
def test_read_only_descriptors_are_matched_and_left_alone():
    a, b = overlapping(4, 60, 50, 0.02, 0.1)
    before = a.copy(), b.copy()
    expected = match_pair(a, b)
    for x in (a, b):
        x.flags.writeable = False
    np.testing.assert_array_equal(match_pair_in_8_bits(a, b), expected)
    np.testing.assert_array_equal(np.concatenate([a, b]), np.concatenate(before))


@needs_8_bits
def test_blocks_do_not_change_the_result(monkeypatch):
    a, b = overlapping(6, 500, 300, 0.02, 0.05)
    whole = match_pair_in_8_bits(a, b)
    assert len(whole) > 100
    monkeypatch.setattr(eight_bit_matching, "BLOCK_BYTES", 1)  # the smallest block there is
    np.testing.assert_array_equal(match_pair_in_8_bits(a, b), whole)


def test_no_descriptors_no_matches():
    none, some = np.zeros((0, 128), np.uint8), descriptors(np.random.default_rng(3), 4)
    for a, b in ((none, some), (some, none), (none, none)):
        assert match_pair_fast(a, b).shape == (0, 2)


def test_without_8_bit_products_the_matches_are_the_same(monkeypatch):
    a, b = overlapping(7, 200, 150, 0.02, 0.05)
    monkeypatch.setattr(eight_bit_matching, "eight_bit_products_are_exact", lambda: False)
    monkeypatch.setattr(eight_bit_matching, "nearest_in_8_bits", None)  # must not be called
    np.testing.assert_array_equal(match_pair_fast(a, b), match_pair(a, b))


def test_correspondences_are_the_same_pairs():
    camera, config = CameraConfig(), SparseConfig()
    rng = np.random.default_rng(8)
    a, b = overlapping(9, 200, 200, 0.01, 0.02)
    keypoints = np.concatenate([rng.uniform(0, 480, (200, 2)), np.ones((200, 2))], axis=1).astype(np.float32)
    shifted = keypoints + np.float32([6, 0, 0, 0])
    first, second = Features(keypoints, a), Features(shifted, b)
    ours = ComputedCorrespondences(camera, config).pair(first, second)
    plain = verify_pair(first, second, match_pair(a, b, config.match_ratio), camera, config)
    assert ours.config == plain.config
    np.testing.assert_array_equal(ours.matches, plain.matches)


@pytest.mark.slow
def test_pytorch_is_loaded_only_where_it_pays():
    script = """
import sys
import numpy as np
from nbv.sparse.eight_bit_matching import match_pair_fast
few = np.full((50, 128), 20, np.uint8)
match_pair_fast(few, few)
assert "torch" not in sys.modules
many = np.random.default_rng(0).integers(0, 90, (9000, 128), dtype=np.uint8)
for _ in range(5):
    match_pair_fast(many, many)
assert "torch" in sys.modules
"""
    subprocess.run([sys.executable, "-c", script], check=True)
