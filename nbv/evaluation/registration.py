"""Registration of a dense cloud to the true surface, for the second number that an evaluation says.

Where telemetry errs, a cloud can be right in shape and wrong in place. As georeferenced it is measured where the
vehicle believes it to be; registered it is measured after the similarity that fits it best to the true surface, as
Tanks and Temples does (Knapitsch et al. 2017, section 4.2): iterative closest point with scale (Besl and McKay 1992;
Umeyama 1991), begun at the georeferenced pose, with correspondences up to a distance that shrinks in stages.
"""

from __future__ import annotations

import numpy as np

from nbv.geometry.frames import Similarity, align_umeyama
from nbv.geometry.neighbours import nearest_neighbours
from nbv.types import Floats

REACHES_M = (1.0, 0.5, 0.2, 0.1, 0.05)  # of correspondences, coarse to fine
ROUNDS = 25  # per stage, at most
MAX_POINTS = 6_000  # of the cloud, evenly picked: a similarity has seven parameters
_STILL_M = 1e-5  # a round that moves the cloud less than this ends its stage
_MIN_PAIRS = 50


def register_cloud(points_m: Floats, truth_m: Floats) -> Similarity:
    """``truth_from_cloud``: the similarity that fits the cloud (N, 3) to samples (S, 3) of the true surface.

    Correspondences run from the cloud to the nearest sample, and from each sample to the nearest point of the
    cloud: one direction alone would shrink the cloud into a corner of the surface. Identity where nothing is
    within reach.
    """
    step = max(1, len(points_m) // MAX_POINTS)
    cloud = np.asarray(points_m, dtype=float)[::step]
    truth = np.asarray(truth_m, dtype=float)[:: max(1, len(truth_m) // MAX_POINTS)]
    found = Similarity(1.0, np.eye(3), np.zeros(3))
    moved = cloud
    for reach_m in REACHES_M:
        for _ in range(ROUNDS):
            forward_m, nearest = nearest_neighbours(truth, moved)
            backward_m, owner = nearest_neighbours(moved, truth)
            ahead, behind = forward_m < reach_m, backward_m < reach_m
            source = np.concatenate([cloud[ahead], cloud[owner[behind]]])
            target = np.concatenate([truth[nearest[ahead]], truth[behind]])
            if len(source) < _MIN_PAIRS:
                break
            found = align_umeyama(target, source)
            before, moved = moved, found.apply(cloud)
            if np.abs(moved - before).max() < _STILL_M:
                break
    return found
