"""The reference surface: seeded samples of a mesh, and which of them any mission could have seen."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nbv.geometry.raycasting import RayCaster
from nbv.geometry.sampling import sample_surface_evenly
from nbv.geometry.visibility import OBSERVABLE_MAX_INCIDENCE_DEG, lifted, seen_from
from nbv.types import Bools, Floats, Ints

MIN_OBSERVING_VIEWS = 2  # a depth needs two rays


@dataclass(frozen=True)
class GroundTruthSamples:
    """Samples of the whole reference surface and the part of it that the camera shell can reach.

    ``observable`` leaves out the underside, what the ground hides and what the rock hides from every
    reachable camera: no planner can win or lose there.
    """

    points_m: Floats  # (S, 3) world frame
    normals: Floats  # (S, 3) unit, outward
    observable: Bools  # (S,)

    def __post_init__(self) -> None:
        if not (len(self.points_m) == len(self.normals) == len(self.observable) > 0):
            raise ValueError("ground-truth points, normals and mask must be non-empty and equally long")


def observable_mask(
    vertices_m: Floats, faces: Ints, points_m: Floats, normals: Floats, camera_centers_m: Floats
) -> Bools:
    """Which samples at least two of the reachable cameras see.

    A camera sees a sample that lies above the ground (z = 0), faces the camera with an incidence of at most 80 degrees,
    and is not hidden by the mesh (`nbv.geometry.visibility`). Image borders are ignored: cameras aim at the target and
    the rock fits the frame. With sample and camera above the ground, the ground plane cannot occlude.

    Parameters
    ----------
    vertices_m, faces
        (V, 3) and (F, 3): the occluding mesh.
    points_m, normals
        (S, 3) each: the samples with unit outward normals.
    camera_centers_m
        (C, 3): every position from which the camera may look, e.g. seed rings and candidate pool.

    Returns
    -------
    (S,) booleans.
    """
    caster = RayCaster(vertices_m, faces)
    points, facing = np.asarray(points_m, dtype=float), np.asarray(normals, dtype=float)
    starts = lifted(points, facing)
    views = np.zeros(len(points), dtype=np.int64)
    open_samples = np.flatnonzero(points[:, 2] > 0)
    # Cameras in a stride order: neighbours on a ring see the same samples, so spreading the first few
    # settles most samples early. The result does not depend on the order.
    centers = np.asarray(camera_centers_m, dtype=float).reshape(-1, 3)
    for center in centers[_spread_order(len(centers))]:
        if open_samples.size == 0:
            break
        seen = seen_from(
            center, starts[open_samples], facing[open_samples], caster, OBSERVABLE_MAX_INCIDENCE_DEG
        )
        views[open_samples[seen]] += 1
        open_samples = open_samples[views[open_samples] < MIN_OBSERVING_VIEWS]
    return views >= MIN_OBSERVING_VIEWS


def build_ground_truth(
    vertices_m: Floats, faces: Ints, camera_centers_m: Floats, n: int, seed: int = 0
) -> GroundTruthSamples:
    """Samples of a mesh and which of them are observable.

    Parameters
    ----------
    vertices_m, faces
        (V, 3) and (F, 3): the rock.
    camera_centers_m
        (C, 3): see `observable_mask`.
    n, seed
        See `sample_surface_evenly`.
    """
    points, normals = sample_surface_evenly(vertices_m, faces, n, seed)
    mask = observable_mask(vertices_m, faces, points, normals, camera_centers_m)
    return GroundTruthSamples(points, normals, mask)


def _spread_order(count: int) -> Ints:
    """A permutation of ``range(count)`` whose consecutive members lie far apart."""
    if count < 3:
        return np.arange(count)
    stride = max(1, round(count * 0.381966))  # golden section
    while np.gcd(stride, count) != 1:
        stride += 1
    return (np.arange(count) * stride) % count
