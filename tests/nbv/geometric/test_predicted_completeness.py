"""The simulated dense stage: what it needs to call a sample reconstructed."""

from itertools import pairwise

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from nbv.config import DenseConfig
from nbv.dense.consistency import choose_witnesses
from nbv.dense.stereo import choose_neighbours
from nbv.geometry.frames import look_at
from nbv.geometry.stereo_chance import (
    DenseModel,
    pairwise_angles_deg,
    reconstruction_probability,
    stereo_partners,
    witness_mask,
)

DENSE = DenseConfig(agreeing_views=3)


def fan(angles_deg):
    a = np.deg2rad(np.asarray(angles_deg, dtype=float))
    return np.column_stack([np.sin(a), np.zeros(len(a)), np.cos(a)])


def probability(angles_deg, seen=None, incidence_deg=0.0, contrast=0.05, dense=DENSE):
    n = len(angles_deg)
    seen = np.ones((n, 1), dtype=bool) if seen is None else seen
    incidence = np.broadcast_to(np.asarray(incidence_deg, dtype=float), seen.shape)
    texture = np.full(seen.shape[1], contrast)
    return reconstruction_probability(seen, incidence, texture, fan(angles_deg), dense, DenseModel())


def test_enough_close_views_reconstruct_and_too_few_do_not():
    assert probability([0, 8, 16, 24, 32, 40, 48])[0] > 0.9
    assert probability([0, 10], dense=DenseConfig(agreeing_views=6))[0] < 0.1  # two can agree, six must
    assert probability([0])[0] == 0.0


def test_a_stricter_agreement_reconstructs_less():
    chance = [
        probability([0, 8, 16, 24, 32], dense=DenseConfig(agreeing_views=need))[0] for need in range(2, 9)
    ]
    assert all(a >= b for a, b in pairwise(chance))
    assert chance[0] > 0.9 > 0.3 > chance[-1]


def test_grazing_views_and_faint_texture_reconstruct_less():
    views = [0, 8, 16, 24, 32, 40]
    by_incidence = [probability(views, incidence_deg=a)[0] for a in (0.0, 50.0, 70.0, 85.0)]
    assert all(a > b for a, b in pairwise(by_incidence)) and by_incidence[-1] < 0.5
    by_contrast = [probability(views, contrast=c)[0] for c in (0.05, 0.005, 0.0005, 0.0)]
    assert all(a > b for a, b in pairwise(by_contrast)) and by_contrast[-1] == 0.0


@settings(max_examples=25)
@given(seed=st.integers(0, 10_000), n=st.integers(2, 20))
def test_partners_and_witnesses_are_those_of_the_dense_stage(seed, n):
    rng = np.random.default_rng(seed)
    target = np.array([0.0, 0.0, 0.8])
    directions = rng.normal((0.0, 0.0, 0.6), 1.0, (n, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    poses = {f"{i:02d}": look_at(target + 3.5 * d, target) for i, d in enumerate(directions)}
    config = DenseConfig(consistency_views=6)
    angles = pairwise_angles_deg(directions)
    partner, usable = stereo_partners(angles, config)
    witnesses = witness_mask(angles, config.consistency_views)
    for i in range(n):
        expected = choose_neighbours(f"{i:02d}", poses, target, config)
        assert [f"{j:02d}" for j in partner[i][usable[i]]] == expected
        expected = choose_witnesses(f"{i:02d}", poses, target, config.consistency_views)
        assert {f"{j:02d}" for j in np.flatnonzero(witnesses[i])} == set(expected)
