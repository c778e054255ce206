"""The surface samplers: points spread over a triangle mesh, the same in every run."""

from __future__ import annotations

import numpy as np

from nbv.errors import UserError
from nbv.geometry.mesh import weighted_normals
from nbv.random_streams import keyed_rng
from nbv.types import Floats, Ints


def sample_surface(vertices_m: Floats, faces: Ints, n: int, seed: int) -> tuple[Floats, Floats]:
    """(n, 3) area-weighted uniform samples of a triangle mesh (V, 3), (F, 3), and (n, 3) their faces' unit normals.

    Faces are drawn with probability proportional to their area, then points uniformly within them
    (Osada et al., "Shape distributions", 2002, Eq. 1). The draw depends on the arguments alone. `UserError` where the mesh has no
    area.
    """
    normals, doubled_area = _normals_and_areas(vertices_m, faces)
    rng = keyed_rng("surface-samples", seed)
    # Inverse-CDF draw; zero-area faces have an empty interval and are never chosen.
    cumulative = np.cumsum(doubled_area)
    chosen = np.searchsorted(cumulative, rng.random(n) * cumulative[-1], side="right")
    chosen = np.minimum(chosen, np.flatnonzero(doubled_area > 0)[-1])
    root, v = np.sqrt(rng.random(n)), rng.random(n)
    return _points_in(vertices_m[faces[chosen]], root, v), normals[chosen] / doubled_area[chosen][:, None]


def sample_surface_evenly(vertices_m: Floats, faces: Ints, n: int, seed: int) -> tuple[Floats, Floats]:
    """Samples as `sample_surface` draws them, but one from each of n patches of equal area.

    Stratified sampling (Cochran, "Sampling Techniques", 1977, chapter 5): faces in the order of a Morton curve through
    their centres, so that a patch is compact, cut into n parts of equal area. A share of the surface that the samples
    tell scatters less over seeds, since only patches on the border of that part of the surface are drawn by lot.
    """
    corners = vertices_m[faces]
    normals, doubled_area = _normals_and_areas(vertices_m, faces)
    order = np.argsort(_morton_keys(corners.mean(axis=1)), kind="stable")
    order = order[doubled_area[order] > 0]
    rng = keyed_rng("even-surface-samples", seed)
    cumulative = np.cumsum(doubled_area[order])
    at = (np.arange(n) + rng.random(n)) / n * cumulative[-1]
    index = np.minimum(np.searchsorted(cumulative, at, side="right"), len(order) - 1)
    chosen = order[index]
    # How far into its own face a draw lies is uniform, too, and keeps the order within large faces.
    within = 1.0 - (cumulative[index] - at) / doubled_area[chosen]
    root, v = np.sqrt(np.clip(within, 0.0, 1.0)), rng.random(n)
    return _points_in(corners[chosen], root, v), normals[chosen] / doubled_area[chosen][:, None]


def _normals_and_areas(vertices_m: Floats, faces: Ints) -> tuple[Floats, Floats]:
    """The triangles' normals (F, 3), as long as twice their areas (F,); `UserError` where there is no area."""
    normals = weighted_normals(vertices_m, faces)
    doubled_area = np.linalg.norm(normals, axis=1)
    total = doubled_area.sum()
    if not np.isfinite(total) or total <= 0:
        raise UserError("the mesh has no surface area; check that the file holds triangles")
    return normals, doubled_area


def _points_in(corners: Floats, root: Floats, v: Floats) -> Floats:
    """(n, 3) points of the triangles (n, 3, 3), uniform where ``root`` squared and ``v`` are."""
    root, v = root[:, None], v[:, None]
    return (1 - root) * corners[:, 0] + root * (1 - v) * corners[:, 1] + root * v * corners[:, 2]


def _morton_keys(points_m: Floats) -> Ints:
    """(N,) positions along a Morton curve of 1024 cells a side: neighbours on it are neighbours in space."""
    low = points_m.min(axis=0)
    side = float((points_m.max(axis=0) - low).max()) or 1.0
    cells = np.minimum((points_m - low) / side * 1024, 1023).astype(np.int64)
    keys = np.zeros(len(cells), dtype=np.int64)
    for bit in range(10):
        for axis in range(3):
            keys |= (cells[:, axis] >> bit & 1) << (3 * bit + axis)
    return keys
