"""Where the target stands, from points alone: the ground as a plane, and what rises from it near the aim.

What a vehicle must do that was told only roughly where its target is, or whose telemetry errs.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy

from nbv.geometry.frames import directions_from
from nbv.geometry.visibility import without_isolated
from nbv.process import keyed_rng
from nbv.types import Bools, Floats, Point

# Planes through points, and the ground among them.


@dataclass(frozen=True)
class Plane:
    """``normal . x = offset_m`` with a unit normal that points up."""

    normal: Floats  # (3,)
    offset_m: float

    def signed_distance_m(self, points_m: Floats) -> Floats:
        """(N,) distances of points (N, 3), positive above the plane."""
        return points_m @ self.normal - self.offset_m

    def height_at_m(self, x_m: float, y_m: float) -> float:
        """z of the plane at (x, y)."""
        return float((self.offset_m - self.normal[0] * x_m - self.normal[1] * y_m) / self.normal[2])


def ground_plane(
    points_m: Floats,
    drawn_from_m: Floats,
    band_m: float,
    is_ground: Callable[[Plane], bool],
    hypotheses: int,
    rng: np.random.Generator,
    most_below: float = 1.0,
) -> Plane | None:
    """The plane with most of the points (N, 3) within ``band_m`` of all that ``is_ground`` (RANSAC, Fischler and Bolles 1981).

    ``hypotheses`` planes are drawn through triples of ``drawn_from_m`` (M, 3); no more than ``most_below`` of the points may lie
    below one. The best is refined by least squares over the points about it, unless that is no ground. None where none is.
    """
    planes = [plane for plane in drawn_planes(drawn_from_m, hypotheses, rng) if is_ground(plane)]
    if not planes:
        return None
    # Single precision is enough to count (points lie within metres of the origin) and twice as fast; so are blocks that
    # stay in the processor's cache.
    normals = np.array([plane.normal for plane in planes], dtype=np.float32)
    offsets = np.array([[plane.offset_m] for plane in planes], dtype=np.float32)
    columns = np.ascontiguousarray(points_m.T, dtype=np.float32)
    near, below = np.zeros((2, len(planes)), dtype=np.int64)
    for start in range(0, len(points_m), 512):
        distance = normals @ columns[:, start : start + 512]
        distance -= offsets
        below += np.count_nonzero(distance < -band_m, axis=1)
        near += np.count_nonzero(np.abs(distance, out=distance) <= band_m, axis=1)
    near[below > most_below * len(points_m)] = 0
    best = int(near.argmax())
    if near[best] == 0:
        return None
    inliers = points_m[np.abs(planes[best].signed_distance_m(points_m)) <= band_m]
    refined = fitted_plane(inliers) if len(inliers) >= 3 else planes[best]
    return refined if is_ground(refined) else planes[best]


def drawn_planes(points_m: Floats, count: int, rng: np.random.Generator) -> list[Plane]:
    """The planes through ``count`` triples of the points (N, 3), without triples on a line."""
    triples = points_m[rng.integers(len(points_m), size=(count, 3))]
    normals = np.cross(triples[:, 1] - triples[:, 0], triples[:, 2] - triples[:, 0])
    lengths = np.linalg.norm(normals, axis=1)
    proper = lengths > 1e-9
    normals = normals[proper] / lengths[proper, None]
    normals *= np.where(normals[:, 2] < 0, -1.0, 1.0)[:, None]
    offsets_m = (normals * triples[proper, 0]).sum(1)
    return [Plane(normal, float(offset_m)) for normal, offset_m in zip(normals, offsets_m)]


def fitted_plane(points_m: Floats) -> Plane:
    """The total-least-squares plane of three points (N, 3) or more."""
    center = points_m.mean(0)
    normal = np.linalg.eigh(np.cov((points_m - center).T))[1][:, 0]
    normal = normal if normal[2] >= 0 else -normal
    return Plane(normal, float(normal @ center))


REACH_M = 4.0  # about the aim, horizontally: the seed orbit's radius
GROUND_BAND_M = 0.06  # to both sides of the plane: noise of sparse points, and a little relief
MAX_TILT_DEG = 20.0  # of the ground, with telemetry's error of attitude
LOWEST_PART_M = 0.25  # of what rises is left out: relief
RADIUS_M = 1.2  # of what is one target
AIM_SD_M = 1.5  # how far from the aim a target may well stand: what is known of it, and telemetry's drift
MAX_BELOW = 0.1  # share of the points that may lie below the ground
MIN_POINTS = 10  # of a target. With this and `_COMPANION_M` 10 of 11 training rocks are found in a fifth of their points
MIN_HALF_EXTENT_M, MAX_HALF_EXTENT_M = 0.2, 2.5
ONE_SIDED = 0.3  # length of the mean direction to the cameras: 0 all round, 0.64 from half of a circle
_TRIALS = 400
_SHIFTS = 20
_CELL_M = 0.1  # of the cells that bound votes
_BATCH = 64  # points whose votes are counted at a time
_COMPANION_M = 0.3  # a point farther from any other is taken for a wrong match


@dataclass(frozen=True)
class FoundTarget:
    """A thing that stands on the ground."""

    center_m: Point  # of its box, from the ground to its top
    half_extent_m: float  # of the box, along its longest axis
    ground_m: float  # height of the ground below its centre


def find_target(
    points_m: Floats, aim_m: Point | Floats, cameras_m: Floats | None = None
) -> FoundTarget | None:
    """What rises highest and most from the ground near ``aim_m`` (3,), from points (N, 3); None where nothing does.

    The ground is the near-horizontal plane with most points about it of all that have hardly any points below
    (`ground_plane`). Points above it vote, by their height, for places within `RADIUS_M`, near the aim more than
    far from it; the best place moves to the middle of its voters (mean shift) until it stays. Ground has a point for
    every pixel and a rock in hard light few, so nothing asks the target's points to hang together.

    ``cameras_m`` (C, 3) are given where they may not have gone round it yet: see `_as_deep_as_wide`.
    """
    points, aim = np.asarray(points_m, dtype=float), np.asarray(aim_m, dtype=float)
    points = points[np.isfinite(points).all(axis=1)]
    points = points[np.linalg.norm(points[:, :2] - aim[:2], axis=1) <= REACH_M]
    if len(points) < MIN_POINTS:
        return None
    level, rng = np.cos(np.deg2rad(MAX_TILT_DEG)), keyed_rng("target-ground", len(points))
    ground = ground_plane(
        points, points, GROUND_BAND_M, lambda plane: plane.normal[2] >= level, _TRIALS, rng, MAX_BELOW
    )
    if ground is None:
        return None
    risen = without_isolated(points[ground.signed_distance_m(points) > LOWEST_PART_M], _COMPANION_M)
    if len(risen) < MIN_POINTS:
        return None
    members = _densest(risen[:, :2], ground.signed_distance_m(risen), aim[:2])
    if np.count_nonzero(members) < MIN_POINTS:
        return None
    low, high = np.percentile(risen[members], [1.0, 99.0], axis=0)
    center = (low + high) / 2
    if cameras_m is not None:
        center[:2] = _as_deep_as_wide(risen[members][:, :2], center[:2], cameras_m[:, :2])
    ground_z_m = float((ground.offset_m - ground.normal[:2] @ center[:2]) / ground.normal[2])
    center[2] = (ground_z_m + high[2]) / 2
    half_m = max(float((high - low)[:2].max()) / 2, float(high[2] - ground_z_m) / 2)
    if not MIN_HALF_EXTENT_M <= half_m <= MAX_HALF_EXTENT_M:
        return None
    x, y, z = (float(v) for v in center)
    return FoundTarget((x, y, z), half_m, ground_z_m)


def _as_deep_as_wide(places_m: Floats, center_m: Floats, cameras_m: Floats) -> Floats:
    """(2,) the centre of a target of which one side has been seen: as far behind its front as it is wide to both sides.

    ``places_m`` (K, 2) are its points, ``center_m`` (2,) the middle of their box, kept where cameras (C, 2) are all round.
    """
    toward = directions_from(center_m, cameras_m).mean(axis=0)
    one_sided = float(np.linalg.norm(toward))
    if one_sided < ONE_SIDED:
        return center_m
    toward /= one_sided
    across = np.array([-toward[1], toward[0]])
    left, right = np.percentile(places_m @ across, [1.0, 99.0])
    back, front = np.percentile(places_m @ toward, [1.0, 99.0])
    depth = min((front + back) / 2, front - (right - left) / 2)
    return np.asarray(across * (left + right) / 2 + toward * depth)


def _densest(places_m: Floats, heights_m: Floats, aim_m: Floats) -> Bools:
    """(K,) the points (K, 2) within `RADIUS_M` of the place that most height votes for."""
    center = places_m[_most_votes(places_m, heights_m, aim_m)]
    for _ in range(_SHIFTS):
        members = np.linalg.norm(places_m - center, axis=1) <= RADIUS_M
        moved = np.average(places_m[members], axis=0, weights=heights_m[members])
        if np.linalg.norm(moved - center) < 0.01:
            break
        center = moved
    return np.asarray(np.linalg.norm(places_m - center, axis=1) <= RADIUS_M)


def _most_votes(places_m: Floats, heights_m: Floats, aim_m: Floats) -> int:
    """The first of the points (K, 2) with most votes: heights (K,) within `RADIUS_M`, times how near the aim it is.

    In a dense cloud nearly every point is within reach of every other. So votes are first bounded from above by cells,
    and only counted, highest bound first, until no other bound reaches the best count.
    """
    nearness = np.exp(-0.5 * (np.linalg.norm(places_m - aim_m, axis=1) / AIM_SD_M) ** 2)
    cells, cell_of = np.unique(np.floor(places_m / _CELL_M), axis=0, return_inverse=True)
    cell_of = cell_of.reshape(-1)
    # Two points are nearer than their cells by half a diagonal each.
    reach_m = RADIUS_M + 1.001 * np.sqrt(2.0) * _CELL_M
    near_cells = scipy.spatial.cKDTree(cells * _CELL_M).query_ball_point(cells * _CELL_M, reach_m)
    cell_heights_m = np.bincount(cell_of, weights=heights_m)
    bounds = np.array([cell_heights_m[near].sum() for near in near_cells])[cell_of] * nearness * (1 + 1e-9)
    tree, best_vote, best = scipy.spatial.cKDTree(places_m), -np.inf, len(places_m)
    order = np.argsort(-bounds, kind="stable")
    for start in range(0, len(order), _BATCH):
        batch = order[start : start + _BATCH]
        if bounds[batch[0]] < best_vote:
            break
        reached = tree.query_ball_point(places_m[batch], RADIUS_M)
        votes = np.array([heights_m[near].sum() for near in reached]) * nearness[batch]
        vote = votes.max()
        first = int(batch[votes == vote].min())
        if vote > best_vote or (vote == best_vote and first < best):
            best_vote, best = vote, first
    return best
