"""Where the vehicle really hovers when it reports that it has arrived."""

from __future__ import annotations

import numpy as np
from scipy.special import ndtr, ndtri

from nbv.config import FlightConfig
from nbv.random_streams import keyed_rng
from nbv.types import Floats, Viewpoint

SIGMAS_IN_TOLERANCE = 3.0


def arrival_position(viewpoint: Viewpoint, limits: FlightConfig, key: tuple[str, int]) -> Floats:
    """(3,) actual camera position (m) for a commanded viewpoint.

    The arrival test is a box of plus or minus ``arrival_tolerance_m`` per axis. A position controller
    does not use it up evenly: the error of each axis is normal with a third of the tolerance as standard
    deviation, truncated to the box. It is drawn per viewpoint and ``key``, (rock's SHA-256, replicate), so it does not
    depend on when or from where the viewpoint is flown to. Never below ``min_camera_altitude_m``.
    """
    uniform = keyed_rng("arrival", *key, viewpoint.id).random(3)
    edge = ndtr(-SIGMAS_IN_TOLERANCE)
    sigmas = ndtri(edge + uniform * (1.0 - 2.0 * edge))
    position: Floats = (
        np.array(viewpoint.position_m) + limits.arrival_tolerance_m / SIGMAS_IN_TOLERANCE * sigmas
    )
    position[2] = max(position[2], limits.min_camera_altitude_m)
    return position
