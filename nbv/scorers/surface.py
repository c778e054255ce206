"""Which sparse points are of the rock, and what it is taken for where these say too little."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from nbv.config import MissionConfig
from nbv.types import Floats

GROUND_CLEARANCE_M = 0.05  # points below are ground, which is at z = 0 to a few centimetres
STRAY_NEIGHBOURS = 10  # a point whose 10th neighbour is three times as far as usual is a stray
STRAY_SPACINGS = 3.0
BALL_POINTS = 200
FEWEST_POINTS = 20  # fewer say nothing of a shape


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


def ball(config: MissionConfig) -> Floats:
    """(BALL_POINTS, 3) evenly on the sphere about the target that touches the ground (Fibonacci lattice)."""
    k = np.arange(BALL_POINTS) + 0.5
    up, bearing = 1.0 - 2.0 * k / BALL_POINTS, k * np.pi * (3.0 - np.sqrt(5.0))
    level = np.sqrt(1.0 - up**2)
    directions = np.column_stack([level * np.cos(bearing), level * np.sin(bearing), up])
    return np.array(config.target_m) + config.target_m[2] * directions
