"""Tanks and Temples' precision and recall: each occupied voxel counts once, however densely it was reconstructed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nbv.evaluation.ground_truth import GroundTruthSamples
from nbv.geometry.neighbours import nearest_neighbours
from nbv.types import Bools, Floats, Ints

_BITS = 21  # of a key for each index: a million voxels either way from the origin


@dataclass(frozen=True)
class Voxels:
    """The V occupied voxels of N points, in lexicographic order."""

    keys: Ints  # (V,) ascending; equal keys are equal voxels, whatever the points
    means_m: Floats  # (V, 3) of the points in each
    voxel_of: Ints  # (N,) each point's, as a row of the others

    @property
    def cells(self) -> Ints:
        """(V, 3) indices; neighbours differ by 1."""
        shifts = np.arange(2, -1, -1) * _BITS
        return (self.keys[:, None] >> shifts & (1 << _BITS) - 1) - (1 << _BITS - 1)


def occupied_voxels(points_m: Floats, voxel_m: float) -> Voxels:
    """The voxels of size ``voxel_m``, the origin a corner of one, that hold a point (N, 3)."""
    x, y, z = np.floor(points_m / voxel_m).astype(np.int64).T + (1 << _BITS - 1)
    keys, voxel_of, counts = np.unique(
        x << 2 * _BITS | y << _BITS | z, return_inverse=True, return_counts=True
    )
    sums = np.stack([np.bincount(voxel_of, weights=points_m[:, k]) for k in range(3)], axis=1)
    return Voxels(keys, sums / counts[:, None], voxel_of)


def voxel_scores(
    points_m: Floats, truth: GroundTruthSamples, threshold_mm: float
) -> dict[str, tuple[float, float]]:
    """Precision and recall in percent on the ``whole`` and the ``observable`` surface.

    Knapitsch et al. 2017, section 4.2 and the published toolbox: the points (N, 3) and the samples are averaged in
    voxels of half the threshold, then Eq. 4 and 6 with strict thresholds. A voxel of samples belongs to the observable
    surface where at least half of its samples do; precision is to the whole surface in both.
    """
    threshold_m = threshold_mm / 1000.0
    cloud, reference = (occupied_voxels(p, threshold_m / 2) for p in (points_m, truth.points_m))
    found = _near(reference, cloud, threshold_m)
    observable = np.bincount(reference.voxel_of, weights=truth.observable - 0.5) >= 0
    precision = _percent(_near(cloud, reference, threshold_m))
    return {
        "whole": (precision, _percent(found)),
        "observable": (precision, _percent(found[observable])),
    }


def _near(these: Voxels, others: Voxels, threshold_m: float) -> Bools:
    """(V,) whether the nearest of the others' means is less than the threshold, twice a voxel's side, away."""
    near = np.isin(these.keys, others.keys, assume_unique=True)  # a voxel's diagonal is 0.87 of the threshold
    open_ = np.flatnonzero(~near)
    distance_m, _ = nearest_neighbours(others.means_m, these.means_m[open_], within_m=threshold_m)
    near[open_] = distance_m < threshold_m
    return near


def _percent(hits: Bools) -> float:
    """0 where there is no voxel."""
    return 100.0 * float(hits.mean()) if len(hits) else 0.0
