"""The surface of the rock as the sparse model shows it: the convex hull of its points, and what a view sees of that.

The parts that no photograph has matched yet exist on it, too.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import ConvexHull, QhullError, cKDTree

from nbv.config import MissionConfig
from nbv.geometry.sampling import sample_surface
from nbv.geometry.visibility import MATCHABLE_MAX_INCIDENCE_DEG, in_frustum
from nbv.types import Bools, Floats

SAMPLES = 1_000
SAMPLE_SEED = 42
GROUND_CLEARANCE_M = 0.05  # points below are ground: the world frame's z = 0, good to a few centimetres
STRAY_NEIGHBOURS = 10  # a point whose 10th neighbour is three times as far as usual is a stray
STRAY_SPACINGS = 3.0
BALL_POINTS = 200
FEWEST_POINTS = 20  # fewer say nothing of a shape


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
