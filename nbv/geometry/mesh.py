"""What trimesh does otherwise, or too slowly: areas, normals weighted by area, bodies joined by any edge, placement."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import lazy_loader
import numpy as np
import scipy
from numpy.typing import NDArray

from nbv.errors import UserError
from nbv.process import keyed_rng
from nbv.types import Bools, Floats, Floats32, Ints

o3d: Any = lazy_loader.load("open3d")  # a planner on a vehicle does without it

# Points by the voxel that they lie in.


def sums_by_voxel(keys: Ints, values: Floats | Floats32) -> tuple[Floats, Ints]:
    """(V, K) sums of the values (N, K) of the points in each occupied voxel, by ascending key (N,), and (V,) how many they are."""
    order = np.argsort(keys, kind="stable")
    starts = np.flatnonzero(np.diff(keys[order], prepend=-1))
    sums = np.add.reduceat(values.take(order, axis=0).astype(np.float64), starts, axis=0)
    return sums, np.diff(np.append(starts, len(order)))


# The one ray caster: a triangle mesh that rays, shadows and distances are asked of (Open3D, Embree).
#
# Single precision and one thread, as everything in a mission: equal input gives equal bits.


@dataclass(frozen=True)
class RayHits:
    """The first thing that each ray meets; the leading shape is that of the rays."""

    t: Floats32  # in lengths of the direction; inf where there is nothing
    face: NDArray[np.uint32]  # 0xFFFFFFFF where there is nothing
    uv: Floats32  # (..., 2) barycentric coordinates in the face


def rays_of(origins_m: NDArray[np.floating], directions: NDArray[np.floating]) -> Floats32:
    """(N, 6) rays from origins (N, 3) or (3,) along directions (N, 3) or (3,), which need not be unit vectors."""
    origins, along = np.broadcast_arrays(origins_m, directions)
    rays = np.empty((*origins.shape[:-1], 6), dtype=np.float32)
    rays[..., :3], rays[..., 3:] = origins, along
    return rays


class RayCaster:
    """One mesh of vertices (V, 3) and faces (F, 3)."""

    def __init__(self, vertices_m: NDArray[np.floating], faces: NDArray[np.integer]) -> None:
        self._scene = o3d.t.geometry.RaycastingScene(nthreads=1)
        self._scene.add_triangles(_tensor(vertices_m, np.float32), _tensor(faces, np.uint32))

    def blocked(self, rays: Floats32, reach: float = np.inf) -> Bools:
        """(N,) does the mesh stand in the way of each ray (N, 6), up to ``reach`` lengths of its direction?"""
        return self._scene.test_occlusions(_tensor(rays), tnear=0.0, tfar=reach, nthreads=1).numpy()

    def cast(self, rays: Floats32) -> RayHits:
        """What each ray (..., 6) meets first."""
        hits = self._scene.cast_rays(_tensor(rays), nthreads=1)
        return RayHits(hits["t_hit"].numpy(), hits["primitive_ids"].numpy(), hits["primitive_uvs"].numpy())

    def distances_m(self, points_m: NDArray[np.floating]) -> Floats:
        """(N,) exact unsigned distance from each point (N, 3) to the surface."""
        return self._scene.compute_distance(_tensor(points_m, np.float32), nthreads=1).numpy().astype(float)


def _tensor(values: NDArray[Any], dtype: type = np.float32) -> Any:
    # A copy where the array is read-only, as rocks are: Open3D would not take it.
    return o3d.core.Tensor.from_numpy(np.require(values, dtype, ["C", "W"]))


# The surface samplers: points spread over a triangle mesh, the same in every run.


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


def face_areas(vertices: Floats, faces: Ints) -> Floats:
    """(F,) areas."""
    return 0.5 * np.asarray(np.linalg.norm(weighted_normals(vertices, faces), axis=1))


def weighted_normals(vertices: Floats, faces: Ints) -> Floats:
    """(F, 3) normals twice as long as the faces' areas."""
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    return np.cross(b - a, c - a)


def vertex_normals(vertices: Floats, faces: Ints) -> Floats:
    """(V, 3) unit normals, weighted by face area; zero where they cancel."""
    weighted = weighted_normals(vertices, faces)
    out = np.zeros((len(vertices), 3))
    for axis in range(3):
        for corner in range(3):
            out[:, axis] += np.bincount(faces[:, corner], weights=weighted[:, axis], minlength=len(vertices))
    lengths = np.linalg.norm(out, axis=1, keepdims=True)
    return np.divide(out, lengths, out=np.zeros_like(out), where=lengths > 0)


def body_labels(faces: Ints) -> Ints:
    """(F,) a label per face; faces that share an edge (also a non-manifold one) share a label."""
    edges = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]], axis=2)  # (F, 3, 2)
    keys = (edges[..., 0] * (int(faces.max(initial=0)) + 1) + edges[..., 1]).ravel()
    _, edge_ids = np.unique(keys, return_inverse=True)
    face_ids = np.repeat(np.arange(len(faces)), 3)
    n = len(faces)
    rows, columns = face_ids, n + edge_ids
    size = n + int(edge_ids.max(initial=0)) + 1
    graph = scipy.sparse.coo_matrix((np.ones(len(rows), dtype=np.int8), (rows, columns)), shape=(size, size))
    return np.asarray(scipy.sparse.csgraph.connected_components(graph, directed=False)[1][:n], dtype=np.int64)


def drop_unused_vertices(vertices: Floats, faces: Ints) -> tuple[Floats, Ints]:
    """The same faces over only the vertices they use, in the same order."""
    used = np.zeros(len(vertices), dtype=bool)
    used[faces] = True
    return vertices[used], (np.cumsum(used) - 1)[faces]


def rest_on_ground(vertices: Floats, height_m: float) -> tuple[Floats, float]:
    """Scale to ``height_m``, centre the bounding box horizontally, put the lowest point at z = 0.

    Returns the vertices (V, 3) and the scale factor.
    """
    low, high = vertices.min(0), vertices.max(0)
    scale = height_m / float(high[2] - low[2])
    origin = np.array([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]])
    placed = (vertices - origin) * scale
    return placed, scale
