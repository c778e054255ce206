"""The one surface sampler: points spread evenly over a triangle mesh, the same in every run."""

from __future__ import annotations

import numpy as np

from nbv.errors import UserError
from nbv.random_streams import keyed_rng
from nbv.types import Floats, Ints


def sample_surface(vertices_m: Floats, faces: Ints, n: int, seed: int) -> tuple[Floats, Floats]:
    """Area-weighted uniform samples of a triangle mesh.

    Faces are drawn with probability proportional to their area, then points uniformly within them
    (Osada et al., "Shape distributions", 2002, Eq. 1). The draw depends on the arguments alone.

    Parameters
    ----------
    vertices_m
        (V, 3) vertices.
    faces
        (F, 3) vertex indices, counter-clockwise seen from outside.
    n
        Number of samples.
    seed
        Any integer.

    Returns
    -------
    points_m, normals
        (n, 3) each; normals are the unit face normals.

    Raises
    ------
    UserError
        The mesh has no area.
    """
    corners = np.asarray(vertices_m, dtype=float)[np.asarray(faces)]
    edge_u, edge_v = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    cross = np.cross(edge_u, edge_v)
    doubled_area = np.linalg.norm(cross, axis=1)
    total = doubled_area.sum()
    if not np.isfinite(total) or total <= 0:
        raise UserError("the mesh has no surface area; check that the file holds triangles")
    rng = keyed_rng("surface-samples", seed)
    # Inverse-CDF draw; zero-area faces have an empty interval and are never chosen.
    cumulative = np.cumsum(doubled_area)
    chosen = np.searchsorted(cumulative, rng.random(n) * cumulative[-1], side="right")
    chosen = np.minimum(chosen, np.flatnonzero(doubled_area > 0)[-1])
    root, v = np.sqrt(rng.random(n))[:, None], rng.random(n)[:, None]
    a, b, c = corners[chosen, 0], corners[chosen, 1], corners[chosen, 2]
    points = (1 - root) * a + root * (1 - v) * b + root * v * c
    return points, cross[chosen] / doubled_area[chosen][:, None]
