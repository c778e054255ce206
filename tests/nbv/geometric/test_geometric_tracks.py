"""Tracks are connected sets of matching detections, whatever the order in which views arrive."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from nbv.geometric.tracks import Tracks


def random_views(seed, n_views, n_landmarks):
    rng = np.random.default_rng(seed)
    directions = rng.normal((0.0, 0.0, 1.5), 1.0, (n_views, n_landmarks, 3))
    directions /= np.linalg.norm(directions, axis=2, keepdims=True)
    return directions, rng.random((n_views, n_landmarks)) < 0.7, np.cos(rng.uniform(0.2, 1.2, n_landmarks))


def add(tracks, directions, detected):
    return tracks.add(np.flatnonzero(detected), directions[detected])


def grouped(tracks, min_views, names):
    landmark, offsets, views = tracks.points(min_views)
    found = [
        (int(point), frozenset(names[v] for v in views[a:b]))
        for point, a, b in zip(landmark, offsets[:-1], offsets[1:])
    ]
    assert len(found) == len(set(found))
    return set(found)


@settings(max_examples=40)
@given(st.integers(0, 10_000), st.integers(1, 9), st.integers(1, 12))
def test_tracks_are_the_connected_components_of_matches(seed, n_views, n_landmarks):
    directions, detected, limit = random_views(seed, n_views, n_landmarks)
    tracks = Tracks(limit, n_views)
    for v in range(n_views):
        add(tracks, directions[v], detected[v])
    expected = set()
    for landmark in range(n_landmarks):
        views = np.flatnonzero(detected[:, landmark])
        rays = directions[views, landmark].astype(np.float32)
        linked = rays @ rays.T >= np.float32(limit[landmark])
        _, label = connected_components(coo_matrix(linked), directed=False)
        groups = [views[label == g] for g in np.unique(label)]
        expected |= {(landmark, frozenset(g.tolist())) for g in groups if len(g) >= 2}
    assert grouped(tracks, 2, range(n_views)) == expected
