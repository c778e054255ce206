"""Matchable repair: how much of the surface a candidate would bring closer to dense reconstruction.

Eq. 8 asks which *sparse points* are weak. Dense stereo reconstructs *surface*, and only where enough views see it
at angles that can be matched. So this term closes the sparse points into a surface (their convex hull: the parts
that no photograph has matched yet exist on it, too) and counts, for samples of it, the views that see them at a
matchable angle to one another. Deployable: it reads the sparse model and the visited viewpoints only.
It is not in the paper.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import ConvexHull, QhullError, cKDTree

from nbv.config import MissionConfig
from nbv.geometry.matchability import matchable_views, matchable_views_with, partners, usable_cosines
from nbv.geometry.sampling import sample_surface
from nbv.geometry.visibility import MATCHABLE_MAX_INCIDENCE_DEG, in_frustum
from nbv.scorers.scorer import Scorer, SharedTerms
from nbv.types import Bools, CandidatePool, Floats, Floats32

SAMPLES = 1_000
SAMPLE_SEED = 42
GROUND_CLEARANCE_M = 0.05  # points below are ground: the world frame's z = 0, good to a few centimetres
STRAY_NEIGHBOURS = 10  # a point whose 10th neighbour is three times as far as usual is a stray
STRAY_SPACINGS = 3.0
BALL_POINTS = 200
FEWEST_POINTS = 20  # fewer say nothing of a shape
BLOCK = 64  # samples at a time: a block's (BLOCK, C, V) arrays stay in the processor's cache


@dataclass(frozen=True)
class ProxySurface:
    """Samples of a closed surface around the sparse points."""

    samples_m: Floats  # (S, 3)
    normals: Floats  # (S, 3) outward unit normals


def proxy_surface(points_m: Floats, config: MissionConfig) -> ProxySurface:
    """Even samples of the convex hull of the rock's points.

    Few seeds leave next to no points on it: where there are fewer than 20, or they span no volume, the surface is a ball
    on the ground about the target, which is where and about as large as the vehicle was told.
    """
    points = points_on_rock(points_m, config)
    try:
        points = points if len(points) >= FEWEST_POINTS else ball(config)
        hull = ConvexHull(points)
    except QhullError:  # all in one plane
        points = ball(config)
        hull = ConvexHull(points)
    return ProxySurface(*sample_hull(points, hull, SAMPLES))


def points_on_rock(points_m: Floats, config: MissionConfig) -> Floats:
    """(K, 3) of points (N, 3) those above the ground within the dense stage's crop around the target, less strays."""
    offset = np.abs(points_m[:, :2] - config.target_m[:2])
    near = (offset.max(axis=1, initial=0.0) <= config.dense.crop_half_width_m) & (
        points_m[:, 2] > GROUND_CLEARANCE_M
    )
    points = points_m[near]
    if len(points) > STRAY_NEIGHBOURS:
        distance = cKDTree(points).query(points, k=STRAY_NEIGHBOURS + 1)[0][:, -1]
        points = points[distance <= STRAY_SPACINGS * np.median(distance)]
    return points


def sample_hull(points_m: Floats, hull: ConvexHull, count: int) -> tuple[Floats, Floats]:
    """Even samples (``count``, 3) of the hull of the points (N, 3), and their outward normals."""
    corners, faces = points_m[hull.simplices], hull.simplices.copy()
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inward = (normals * hull.equations[:, :3]).sum(
        axis=1
    ) < 0  # Qhull's equations point out, its triangles need not
    faces[inward] = faces[inward, ::-1]
    return sample_surface(points_m, faces, count, SAMPLE_SEED)


def ball(config: MissionConfig) -> Floats:
    """(BALL_POINTS, 3) evenly on the sphere about the target that touches the ground (Fibonacci lattice)."""
    k = np.arange(BALL_POINTS) + 0.5
    up, bearing = 1.0 - 2.0 * k / BALL_POINTS, k * np.pi * (3.0 - np.sqrt(5.0))
    level = np.sqrt(1.0 - up**2)
    directions = np.column_stack([level * np.cos(bearing), level * np.sin(bearing), up])
    return np.array(config.target_m) + config.target_m[2] * directions


def sees(surface: ProxySurface, positions_m: Floats, config: MissionConfig) -> Bools:
    """(S, N): in the image of each view aimed at the target, its front side, within 75 degrees of incidence.

    A convex surface hides nothing else of itself.
    """
    to_view = positions_m[None] - surface.samples_m[:, None]
    facing = np.einsum("snk,sk->sn", to_view, surface.normals)
    distance = np.sqrt(np.einsum("snk,snk->sn", to_view, to_view))
    front = facing > distance * np.cos(np.deg2rad(MATCHABLE_MAX_INCIDENCE_DEG))
    return front & in_frustum(surface.samples_m, positions_m, np.array(config.target_m), config.camera)


def expected_gain_percent(
    points_m: Floats, candidate_m: Floats, visited_m: Floats, config: MissionConfig
) -> float:
    """Of all matchable views that the surface estimated from sparse points (N, 3) needs, the share (%) that one more view would add.

    The view is from ``candidate_m`` (3,), those so far from ``visited_m`` (V, 3).
    """
    surface = proxy_surface(points_m, config)
    gained, _ = views_gained(surface, candidate_m.reshape(1, 3), visited_m, config)
    return 100.0 * float(gained[0]) / (len(surface.samples_m) * config.matchable.views)


def views_gained(
    surface: ProxySurface, candidates_m: Floats, visited_m: Floats, config: MissionConfig
) -> tuple[Floats, int]:
    """(C,) matchable views that each candidate (C, 3) would add to those visited (V, 3) over all samples, and how many are missing.

    What a sample has is counted in `nbv.geometry.matchability`; it needs ``matchable.views``.
    """
    need = config.matchable.views
    n_visited = len(visited_m)
    views = np.concatenate([visited_m.reshape(-1, 3), candidates_m])
    visible = sees(surface, views, config)
    gained = np.zeros(len(candidates_m))
    missing = 0
    for start in range(0, len(surface.samples_m), BLOCK):
        samples, seen = surface.samples_m[start : start + BLOCK], visible[start : start + BLOCK]
        have = partners(_pairs(samples, visited_m, visited_m, config), seen[:, :n_visited])
        before = np.minimum(matchable_views(have), need)  # (S,)
        lacks = before < need
        if not lacks.any():
            continue
        samples, seen, have, before = samples[lacks], seen[lacks], have[lacks], before[lacks]
        new = _pairs(samples, candidates_m, visited_m, config)  # (S, C, V)
        new &= seen[:, n_visited:, None] & seen[:, None, :n_visited]
        after = np.minimum(matchable_views_with(have, new, seen[:, n_visited:]), need)  # (S, C)
        gained += (after - before[:, None]).sum(axis=0)
        missing += int((need - before).sum())
    return gained, missing


def _pairs(samples_m: Floats, a_m: Floats, b_m: Floats, config: MissionConfig) -> Bools:
    """(S, A, B): can two views be matched, as seen from a sample?"""

    def directions(positions_m: Floats) -> Floats32:
        delta = (positions_m.reshape(1, -1, 3) - samples_m[:, None]).astype(np.float32)
        delta /= np.sqrt(np.einsum("snk,snk->sn", delta, delta))[:, :, None]
        return delta

    return usable_cosines(directions(a_m) @ directions(b_m).transpose(0, 2, 1), config.dense)


def matchable_repair(terms: SharedTerms, pool: CandidatePool, config: MissionConfig) -> Floats:
    """(C,) share of all matchable views still missing that each candidate would add, in [0, 1]; zeros where none is."""
    surface = proxy_surface(terms.box.points_m, config)
    gained, missing = views_gained(surface, pool.positions_m, terms.visited_m, config)
    return gained / max(missing, 1)


MATCHABLE = Scorer("matchable", matchable_repair, weights=lambda config: config.matchable.weights)
