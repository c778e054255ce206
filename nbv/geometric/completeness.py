"""Which surface samples the dense stage would reconstruct, from visibility and angles alone.

The rule mirrors `nbv.dense`: a view has a depth at a sample when it and another view at a usable angle see
it well enough; a depth is kept when enough views with depths of their own confirm it. It differs on
purpose in two ways. Every usable partner and every witness within an angle counts, not the nearest few, so
one more view never makes the prediction worse. And all is probability: a steep surface gives a depth
sometimes, so the number of confirming views is a soft count.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from nbv.config import DenseConfig, MissionConfig
from nbv.geometric.world import GeometricWorld
from nbv.types import Floats

Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class DenseModel:
    """Free constants of the stand-in's dense stage; ``benchmarks/geometric_calibration.py`` fits them."""

    incidence_deg: float = 76.0  # at this incidence a depth succeeds half the time
    incidence_width_deg: float = 6.0
    max_pair_angle_deg: float = 35.0  # with ``dense.max_pair_angle_deg`` the smaller counts
    witness_angle_deg: float = 60.0  # views at most this far apart confirm each other
    agreement_offset: float = 0.0  # added to ``dense.agreeing_views``
    agreement_width: float = 0.5  # softness of the threshold, in views


def reconstruction_probability(
    seen: Mask,
    incidence_cosine: Floats,
    directions: Floats,
    dense: DenseConfig,
    model: DenseModel,
) -> Floats:
    """(S,) chance that each sample is reconstructed; 0 where no view sees it; never falls with more views.

    Parameters
    ----------
    seen, incidence_cosine
        (V, S): who sees what, and the cosine between surface normal and line of sight.
    directions
        (V, 3) unit vectors from the target to the cameras.
    """
    if len(seen) < 2:
        return np.zeros(seen.shape[1])
    clipped = np.clip(incidence_cosine, -1.0, 1.0)
    steepness = (np.arccos(clipped) * (180.0 / np.pi) - model.incidence_deg) / model.incidence_width_deg
    alone = np.where(seen, expit(-steepness), 0.0)  # chance of a depth, were there a partner

    angle_deg = np.rad2deg(np.arccos(np.clip(directions @ directions.T, -1.0, 1.0)))
    others = ~np.eye(len(directions), dtype=bool)
    widest = min(dense.max_pair_angle_deg, model.max_pair_angle_deg)
    partners = others & (angle_deg >= dense.min_pair_angle_deg) & (angle_deg <= widest)
    witnesses = others & (angle_deg <= model.witness_angle_deg)

    no_partner = np.exp(partners.astype(alone.dtype) @ np.log1p(-np.minimum(alone, 0.999)))
    depth = alone * (1.0 - no_partner)
    agreeing = 1.0 + witnesses.astype(alone.dtype) @ depth
    need = dense.agreeing_views + model.agreement_offset
    kept = depth * expit((agreeing - need) / model.agreement_width)
    return kept.max(axis=0)


def within_reach(
    probability: Floats, neighbours: NDArray[np.integer], distance_m: Floats, t_m: float
) -> Floats:
    """(S,) chance that something is reconstructed within ``t_m`` of each sample.

    ``neighbours`` and ``distance_m`` are (S, K): each sample's nearest samples, itself first.
    """
    return np.where(distance_m < t_m, probability[neighbours], 0.0).max(axis=1)


def sample_probability(
    world: GeometricWorld,
    rows: Sequence[int],
    camera_centers_m: Floats,
    config: MissionConfig,
    model: DenseModel,
) -> Floats:
    """(S,) `reconstruction_probability` of a world's samples.

    Parameters
    ----------
    rows, camera_centers_m
        (V,) the views' rows in the world's tables, (V, 3) where they were really taken from.
    """
    points, normals = world.samples_m.astype(np.float32), world.sample_normals.astype(np.float32)
    directions = camera_centers_m - np.array(config.target_m)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    centers = camera_centers_m.astype(np.float32)  # rounding of micrometres decides nothing here
    # Incidence: (c - p) . n / |c - p| for all views and samples.
    facing = centers @ normals.T - np.einsum("ij,ij->i", points, normals)
    squared = (centers**2).sum(axis=1)[:, None] + (points**2).sum(axis=1) - 2.0 * centers @ points.T
    return reconstruction_probability(
        world.sample_seen[list(rows)], facing / np.sqrt(squared), directions, config.dense, model
    )
