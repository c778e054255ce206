"""Which places a camera sees: what lies in its image (`in_frustum`), and what of a surface it sees (`seen_from`).

A camera sees a place whose front faces it at no more than a largest incidence and which the mesh does not hide. Whether
that also lies in the image is a question of its own, since some let the camera turn. Of sparse points all that lies in the
image counts, as in the paper: inside the image of an exact zero-roll camera aimed at the target, so also behind the rock.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from nbv.config import CameraConfig, DenseConfig, MissionConfig
from nbv.geometry.frames import directions_from
from nbv.geometry.mesh import RayCaster, rays_of
from nbv.types import Bools, Floats, Floats32, Ints

# Which views dense stereo could match with one another.
#
# Two views of a sample are matchable where the angle between them, as seen from the sample, lies between
# ``dense.min_pair_angle_deg`` and ``dense.max_pair_angle_deg``.


def usable_angles(angle_deg: Any, dense: DenseConfig) -> Any:
    """Whether two views so far apart can be matched; a mask for an array of angles."""
    return (angle_deg >= dense.min_pair_angle_deg) & (angle_deg <= dense.max_pair_angle_deg)


def usable_cosines(cosine: NDArray[np.floating[Any]], dense: DenseConfig) -> Bools:
    """`usable_angles` from the angles' cosines, in their precision."""
    near = np.cos(np.deg2rad(dense.min_pair_angle_deg)).astype(cosine.dtype)
    far = np.cos(np.deg2rad(dense.max_pair_angle_deg)).astype(cosine.dtype)
    return (cosine <= near) & (cosine >= far)


def stereo_partners(
    angle_deg: Floats, dense: DenseConfig, allowed: Bools | None = None
) -> tuple[NDArray[np.intp], Bools]:
    """(V, K) each view's partners in stereo, up to ``dense.neighbours``, best first, and which of them may be matched.

    ``angle_deg`` (V, V) is between the views as seen from the target; ``allowed`` (V, V) leaves out further pairs. A factor off
    ``dense.best_pair_angle_deg`` costs the same either way (too narrow: imprecise; too wide: different looks). Ties keep the order.
    """
    off_best = np.abs(np.log(np.maximum(angle_deg, 1e-9) / dense.best_pair_angle_deg))
    usable = usable_angles(angle_deg, dense) & ~np.eye(len(angle_deg), dtype=bool)
    off_best[~usable if allowed is None else ~(usable & allowed)] = np.inf
    partner = np.argsort(off_best, axis=1, kind="stable")[:, : dense.neighbours]
    return partner, np.isfinite(np.take_along_axis(off_best, partner, axis=1))


def nearest_views(angle_deg: Floats, count: int) -> NDArray[np.intp]:
    """(V, K) the ``count`` other views, or all, nearest in direction, nearest first; ``angle_deg`` as in `stereo_partners`."""
    apart = np.where(np.eye(len(angle_deg), dtype=bool), np.inf, angle_deg)
    return np.argsort(apart, axis=1, kind="stable")[:, : min(count, len(apart) - 1)]


# Distances to nearest neighbours: any two clouds, and one small cloud within itself, worked out once.
#
# Queries are visited in an order in which neighbours follow each other, so that the branches of the tree that one query needs
# are still in the processor's cache for the next. One thread, as everything in a mission.


_LEAF = 32  # points in a leaf of a tree
_LEAF_FOR_ONE = 128  # where one neighbour is asked for: half the time of 32 for a cloud half a metre off


def nearest_neighbours(points_m: Floats, queries_m: Floats, k: int = 1) -> tuple[Floats, Ints]:
    """Distances to, and indices of, the ``k`` nearest of points (N, 3), N >= ``k``, for each query (Q, 3): (Q, k) each, nearest first.

    (Q,) for ``k = 1``. Several times faster than a plain query on large clouds.
    """
    tree = scipy.spatial.cKDTree(points_m, leafsize=_LEAF if k > 1 else _LEAF_FOR_ONE)
    if queries_m is points_m:
        order = tree.indices
    else:
        how = {"leafsize": _LEAF, "balanced_tree": False, "compact_nodes": False}
        order = scipy.spatial.cKDTree(queries_m, **how).indices
    sorted_distances, sorted_indices = tree.query(queries_m[order], k=k, workers=1)
    distances, indices = np.empty_like(sorted_distances), np.empty_like(sorted_indices)
    distances[order], indices[order] = sorted_distances, sorted_indices
    return distances, indices


def without_isolated(points_m: Floats, within_m: float) -> Floats:
    """Of points (N, 3) those with two others within ``within_m``; all of fewer than three."""
    if len(points_m) < 3:
        return points_m
    return np.asarray(points_m[scipy.spatial.cKDTree(points_m).query(points_m, k=3)[0][:, -1] <= within_m])


def neighbour_distances(points_m: Floats, k: int) -> Floats:
    """(N, k) distances from each of the N > k points to its ``k`` nearest others, nearest first (read-only).

    Stopping rule, gate features and B-aware's local sparsity ask the same question of the same points in one
    iteration. The memory is keyed by the points themselves, so it is invisible except in time.
    """
    points = np.ascontiguousarray(points_m, dtype=np.float64)
    return _distances(points.tobytes(), len(points), k)


@lru_cache(maxsize=4)
def _distances(data: bytes, n: int, k: int) -> Floats:
    points = np.frombuffer(data).reshape(n, -1)
    distances = nearest_neighbours(points, points, k + 1)[0][:, 1:]  # the nearest is the point itself, at 0
    distances.setflags(write=False)
    return distances


def knn_d95_m(points_m: Floats, config: MissionConfig) -> float:
    """Eq. 9's statistic: of points (N, 3), the 95th percentile (m) of the distance to the k-th neighbour, itself excluded.

    ``stop`` says which neighbour, and whether only points in the paper's box (section III-A) count. Fewer than k + 1 points
    give infinity: such a cloud has certainly not converged.
    """
    k, points = config.stop.knn_neighbours, np.asarray(points_m, dtype=float).reshape(-1, 3)
    if config.stop.knn_region == "box":
        offset_m = np.abs(points - np.asarray(config.target_m))
        points = points[(offset_m <= config.shared.box_half_extent_m).all(axis=1)]
    if len(points) < k + 1:
        return np.inf
    return float(np.percentile(neighbour_distances(points, k)[:, -1], 95))


SURFACE_OFFSET_M = 1e-4  # lifts a ray off the facet that it starts from
# How slanted a surface may be seen: the largest angle between its normal and the line of sight, one for each question.
MATCHABLE_MAX_INCIDENCE_DEG = 75.0  # to plan views by: beyond this a photograph says little about the surface
OBSERVABLE_MAX_INCIDENCE_DEG = 80.0  # to evaluate on: beyond this it is foreshortened more than 5.8 times
LANDMARK_MAX_INCIDENCE_DEG = 86.0  # of the simulator's landmarks; detection has limits of its own
BLOCK = 256  # points at a time: a block's (BLOCK, C) arrays stay in the processor's cache


def in_frustum(points_m: Floats, positions_m: Floats, target_m: Floats, camera: CameraConfig) -> Bools:
    """(P, C): is each point (P, 3) in the image of the camera at each position (C, 3), aimed at the target (3,)?

    The principal point is the image's centre: a point is inside where neither of its scaled coordinates across the line of
    sight exceeds its depth.
    """
    right, down, forward = camera_axes(positions_m, target_m)
    x, y, z = (
        scale * np.concatenate([axis.T, -np.einsum("ij,ij->i", axis, positions_m)[None]])
        for axis, scale in (
            (right, camera.focal_px / (camera.width_px / 2.0)),
            (down, camera.focal_px / (camera.height_px / 2.0)),
            (forward, 1.0),
        )
    )
    homogeneous = np.column_stack([points_m, np.ones(len(points_m))])
    visible = np.empty((len(points_m), len(positions_m)), dtype=bool)
    for start in range(0, len(points_m), BLOCK):
        block = homogeneous[start : start + BLOCK]
        off_axis = np.maximum(np.abs(block @ x), np.abs(block @ y))
        visible[start : start + BLOCK] = off_axis <= block @ z
    return visible


def camera_axes(positions_m: Floats, target_m: Floats) -> tuple[Floats, Floats, Floats]:
    """(C, 3) each: right, down and forward of `nbv.geometry.frames.look_at` for every position at once."""
    forward = directions_from(positions_m, target_m)
    right = np.cross(forward, (0.0, 0.0, 1.0))
    straight = np.linalg.norm(right, axis=1) < 1e-9  # up or down: the image's up is north
    right[straight] = np.cross(forward[straight], (0.0, 1.0, 0.0))
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    return right, np.cross(forward, right), forward


def incidences_deg(points_m: NDArray[Any], normals: NDArray[Any], cameras_m: NDArray[Any]) -> Floats32:
    """(V, P) angles between the normals (P, 3) of places (P, 3) and the lines of sight from these to cameras (V, 3)."""
    # (c - p) . n / |c - p| by products of matrices: several times as fast as difference by difference.
    cosine = cameras_m @ normals.T - np.einsum("ij,ij->i", points_m, normals)
    squared = (cameras_m**2).sum(axis=1)[:, None] + (points_m**2).sum(axis=1) - 2.0 * cameras_m @ points_m.T
    cosine = (cosine / np.sqrt(squared)).astype(np.float32)
    return np.rad2deg(np.arccos(np.clip(cosine, -1.0, 1.0)))


def seen_from(
    center_m: Floats, starts_m: Floats, normals: Floats, caster: RayCaster, max_incidence_deg: float
) -> Bools:
    """(P,) does the camera at ``center_m`` (3,) see each place?

    ``starts_m`` (P, 3) are the places lifted off the surface (`SURFACE_OFFSET_M`), ``normals`` (P, 3) unit and outward, ``caster`` the mesh that
    may hide them. The angle between normal and direction to the camera is at most ``max_incidence_deg``.
    """
    to_camera = center_m - starts_m
    distance_m = np.linalg.norm(to_camera, axis=1)
    seen: Bools = (to_camera * normals).sum(axis=1) >= (np.cos(np.deg2rad(max_incidence_deg)) * distance_m)
    ask = np.flatnonzero(seen)
    # Directions are not normalised, so the camera is one length away.
    seen[ask[caster.blocked(rays_of(starts_m[ask], to_camera[ask]), reach=1.0)]] = False
    return seen
