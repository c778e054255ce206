"""The chance that dense stereo reconstructs a place of a surface, from who sees it and at which angles alone.

The rules are those of `nbv.dense`, as chances: a view is matched with its best ``dense.neighbours`` by
angle, a sample gets a depth when one of these pairs matches there, and the depth is kept when enough of the
``dense.consistency_views`` nearest views confirm it with depths of their own. A pair matches the less the
more either view, or only one of them, looks at the surface at a grazing angle, and the fainter the
texture is. As in the real stage, one more view can take the place of a better one.
"""

from __future__ import annotations

import numpy as np

from nbv.config import DenseConfig
from nbv.geometry.frames import angles_deg
from nbv.geometry.visibility import nearest_views, stereo_partners
from nbv.types import Bools, Floats, Floats32

# Fitted by maximum likelihood to real depth maps, sample by sample (``research/geometric_calibration.py`` at 98aed9d;
# docs/results/index.md).
INCIDENCE_DEG = 76.4  # at this incidence a view is good for a match half the time
INCIDENCE_WIDTH_DEG = 14.0
HALF_CONTRAST = 0.0018  # at this local contrast half of the matches fail
ANGLE_DECAY_PER_DEG = 0.0035  # of a pair's chance, with the angle between the two
SLANT_DECAY_PER_DEG = 0.0066  # with the difference of the two incidences
AGREEMENT = 0.893  # chance that a source view with a depth confirms
CONFIRMING_INCIDENCE_DEG = 91.1  # at which this is half of that
CONFIRMING_INCIDENCE_WIDTH_DEG = 25.6
AGREEMENT_SD = 1.81  # of the number of confirming views about its expectation


def reconstruction_probability(
    seen: Bools,
    incidence_deg: Floats | Floats32,
    contrast: Floats,
    directions: Floats,
    dense: DenseConfig,
    angle_decay_per_deg: float = ANGLE_DECAY_PER_DEG,
) -> Floats32:
    """(S,) chance that each sample is reconstructed; 0 where no view sees it.

    ``seen`` (V, S) is who sees what, ``incidence_deg`` (V, S) the angle between surface normal and line of sight, ``contrast`` (S,) the
    local contrast (standard deviation of the shaded albedo, 0 to 1), ``directions`` (V, 3) unit vectors from the target to the
    cameras.
    """
    if len(seen) < 2:
        return np.zeros(seen.shape[1], dtype=np.float32)
    incidence: Floats32 = np.asarray(incidence_deg, dtype=np.float32)
    angle_deg = angles_deg(directions, directions)
    depth = depth_probability(seen, incidence, contrast, angle_deg, dense, angle_decay_per_deg)

    width = np.float32(CONFIRMING_INCIDENCE_WIDTH_DEG)
    confirms = logistic((np.float32(CONFIRMING_INCIDENCE_DEG) - incidence) / width)
    confirms *= depth
    sources = np.zeros(angle_deg.shape, dtype=np.float32)
    nearest = nearest_views(angle_deg, dense.consistency_views)
    np.put_along_axis(sources, nearest, np.float32(AGREEMENT), axis=1)
    agreeing: Floats32 = sources @ confirms
    agreeing += np.float32(1.5 - dense.agreeing_views)  # with the view itself; a count rounds at the half
    # The logistic curve nearest to the normal distribution's.
    agreeing *= np.float32(1.702 / AGREEMENT_SD)
    confirmed = logistic(agreeing)
    confirmed *= depth
    lost = np.prod(np.subtract(np.float32(1.0), confirmed, out=confirmed), axis=0)
    return np.subtract(np.float32(1.0), lost)


def depth_probability(
    seen: Bools,
    incidence: Floats32,
    contrast: Floats,
    angle_deg: Floats,
    dense: DenseConfig,
    angle_decay_per_deg: float = ANGLE_DECAY_PER_DEG,
) -> Floats32:
    """(V, S) chance that each view has a depth at each sample, confirmed or not; ``angle_deg`` (V, V) between the views."""
    texture = (contrast / (contrast + HALF_CONTRAST)).astype(np.float32)
    good = good_view(seen, incidence)

    partner, usable = stereo_partners(angle_deg, dense)
    between = np.take_along_axis(angle_deg, partner, axis=1)
    pair = np.where(usable, np.exp(-angle_decay_per_deg * between), 0.0).astype(np.float32)
    no_depth = np.ones_like(good)
    for k in range(partner.shape[1]):
        other = partner[:, k]
        slant = np.abs(incidence - incidence[other])
        slant *= np.float32(-SLANT_DECAY_PER_DEG)
        match = np.exp(slant, out=slant)
        match *= good[other]
        match *= good
        match *= texture
        match *= pair[:, k, None]
        no_depth *= np.subtract(np.float32(1.0), match, out=match)
    return np.subtract(np.float32(1.0), no_depth, out=no_depth)


def good_view(seen: Bools, incidence_deg: Floats32) -> Floats32:
    """(V, S) of a pair's chance to match, what each view brings."""
    steepness: Floats32 = np.float32(INCIDENCE_DEG) - incidence_deg
    steepness /= np.float32(INCIDENCE_WIDTH_DEG)
    good = logistic(steepness)
    good *= seen
    return good


def logistic(x: Floats32) -> Floats32:
    """1 / (1 + exp(-x)), in place."""
    np.negative(x, out=x)
    np.minimum(x, np.float32(80.0), out=x)  # exp must not overflow
    np.exp(x, out=x)
    x += np.float32(1.0)
    return np.divide(np.float32(1.0), x, out=x)
