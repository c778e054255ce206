"""The stand-in's dense stage: what it needs to call a sample reconstructed."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nbv.config import DenseConfig
from nbv.geometric.completeness import DenseModel, reconstruction_probability, within_reach

DENSE = DenseConfig(agreeing_views=3)


def fan(angles_deg):
    a = np.deg2rad(np.asarray(angles_deg, dtype=float))
    return np.column_stack([np.sin(a), np.zeros(len(a)), np.cos(a)])


def probability(angles_deg, seen=None, cosine=1.0, dense=DENSE, model=DenseModel()):  # noqa: B008
    n = len(angles_deg)
    seen = np.ones((n, 1), dtype=bool) if seen is None else seen
    return reconstruction_probability(seen, np.full(seen.shape, cosine), fan(angles_deg), dense, model)


def test_enough_close_views_reconstruct_and_too_few_do_not():
    assert probability([0, 10, 20, 30, 40])[0] > 0.9
    assert probability([0, 10])[0] < 0.2  # two agree, three are needed
    assert probability([0])[0] == 0.0


def test_views_too_far_apart_give_no_depth():
    assert probability([0, 90, 180, 270])[0] == 0.0


def test_views_in_one_place_give_no_depth():
    assert probability([0, 0, 0, 0, 0])[0] == 0.0


def test_a_stricter_agreement_reconstructs_less():
    chance = [
        probability([0, 8, 16, 24, 32], dense=DenseConfig(agreeing_views=need))[0] for need in range(2, 8)
    ]
    assert all(a >= b for a, b in pairwise(chance))
    assert chance[0] > 0.9 > 0.1 > chance[-1]


def test_a_grazing_surface_is_not_reconstructed():
    assert probability([0, 10, 20, 30], cosine=np.cos(np.deg2rad(89)))[0] < 0.05


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10_000))
def test_one_more_view_never_hurts(seed):
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 12))
    directions = rng.normal((0.0, 0.0, 1.0), 1.0, (n + 1, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    seen, cosine = rng.random((n + 1, 40)) < 0.6, rng.uniform(-0.2, 1.0, (n + 1, 40))
    before = reconstruction_probability(seen[:n], cosine[:n], directions[:n], DENSE, DenseModel())
    after = reconstruction_probability(seen, cosine, directions, DENSE, DenseModel())
    assert (after >= before - 1e-12).all()
    assert (after <= 1.0).all()


def test_what_no_view_sees_is_never_reconstructed():
    seen = np.ones((6, 3), dtype=bool)
    seen[:, 1] = False
    chance = probability([0, 10, 20, 30, 40, 50], seen=seen)
    assert chance[1] == 0.0
    assert chance[0] > 0.9


def test_reach_takes_the_best_neighbour_within_the_threshold():
    neighbours = np.array([[0, 1, 2], [1, 0, 2], [2, 1, 0]])
    distance = np.array([[0, 0.02, 0.06], [0, 0.02, 0.04], [0, 0.04, 0.06]])
    chance = np.array([0.1, 0.5, 0.9])
    assert within_reach(chance, neighbours, distance, 0.01) == pytest.approx([0.1, 0.5, 0.9])
    assert within_reach(chance, neighbours, distance, 0.03) == pytest.approx([0.5, 0.5, 0.9])
    assert within_reach(chance, neighbours, distance, 0.05) == pytest.approx([0.5, 0.9, 0.9])
