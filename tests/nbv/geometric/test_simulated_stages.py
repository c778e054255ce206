"""The simulated sparse stage's tracks, and what the simulated dense stage needs to call a sample reconstructed."""

from itertools import pairwise

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from nbv.config import DenseConfig
from nbv.geometric.world import Tracks
from nbv.geometry.stereo_chance import reconstruction_probability

DENSE = DenseConfig(agreeing_views=3)


def fan(angles_deg):
    a = np.deg2rad(np.asarray(angles_deg, dtype=float))
    return np.column_stack([np.sin(a), np.zeros(len(a)), np.cos(a)])


def probability(angles_deg, seen=None, incidence_deg=0.0, contrast=0.05, dense=DENSE):
    n = len(angles_deg)
    seen = np.ones((n, 1), dtype=bool) if seen is None else seen
    incidence = np.broadcast_to(np.asarray(incidence_deg, dtype=float), seen.shape)
    texture = np.full(seen.shape[1], contrast)
    return reconstruction_probability(seen, incidence, texture, fan(angles_deg), dense)


def test_enough_close_views_reconstruct_and_too_few_do_not():
    assert probability([0, 8, 16, 24, 32, 40, 48])[0] > 0.9
    assert probability([0, 10], dense=DenseConfig(agreeing_views=6))[0] < 0.1  # two can agree, six must
    assert probability([0])[0] == 0.0


def test_grazing_views_and_faint_texture_reconstruct_less():
    views = [0, 8, 16, 24, 32, 40]
    by_incidence = [probability(views, incidence_deg=a)[0] for a in (0.0, 50.0, 70.0, 85.0)]
    assert all(a > b for a, b in pairwise(by_incidence)) and by_incidence[-1] < 0.5
    by_contrast = [probability(views, contrast=c)[0] for c in (0.05, 0.005, 0.0005, 0.0)]
    assert all(a > b for a, b in pairwise(by_contrast)) and by_contrast[-1] == 0.0


@settings(max_examples=40)
@given(st.integers(0, 10_000), st.integers(1, 9), st.integers(1, 12))
def test_tracks_are_the_connected_components_of_matches(seed, n_views, n_landmarks):
    rng = np.random.default_rng(seed)
    directions = rng.normal((0.0, 0.0, 1.5), 1.0, (n_views, n_landmarks, 3))
    directions /= np.linalg.norm(directions, axis=2, keepdims=True)
    detected = rng.random((n_views, n_landmarks)) < 0.7
    limit = np.cos(rng.uniform(0.2, 1.2, n_landmarks))
    tracks = Tracks(limit, n_views)
    for view in range(n_views):
        tracks.add(np.flatnonzero(detected[view]), directions[view, detected[view]])
    landmarks, offsets, of_views = tracks.points(2)
    found = [
        (landmark, frozenset(of_views[a:b].tolist()))
        for landmark, a, b in zip(landmarks.tolist(), offsets[:-1], offsets[1:])
    ]
    expected = set()
    for landmark in range(n_landmarks):
        views = np.flatnonzero(detected[:, landmark])
        rays = directions[views, landmark].astype(np.float32)
        linked = rays @ rays.T >= np.float32(limit[landmark])
        _, label = connected_components(coo_matrix(linked), directed=False)
        groups = [views[label == g] for g in np.unique(label)]
        expected |= {(landmark, frozenset(g.tolist())) for g in groups if len(g) >= 2}
    assert len(found) == len(expected) and set(found) == expected
