"""The one ray caster: a triangle mesh that rays, shadows and distances are asked of (Open3D, Embree).

Single precision and one thread, as everything in a mission: equal input gives equal bits.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nbv.types import Bools, Floats, Floats32


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
        import open3d as o3d  # noqa: PLC0415  a planner on a vehicle does without it

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

    def nearest(self, points_m: NDArray[np.floating]) -> tuple[Floats32, Floats]:
        """(N, 3) the place of the surface nearest to each point (N, 3), and (N, 3) its unit normal there."""
        closest = self._scene.compute_closest_points(_tensor(points_m, np.float32), nthreads=1)
        return closest["points"].numpy(), closest["primitive_normals"].numpy().astype(float)


def _tensor(values: NDArray[Any], dtype: type = np.float32) -> Any:
    # A copy where the array is read-only, as rocks are: Open3D would not take it.
    import open3d as o3d  # noqa: PLC0415

    return o3d.core.Tensor.from_numpy(np.require(values, dtype, ["C", "W"]))
