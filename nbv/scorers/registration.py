"""Will a photograph from there register? A chance from the sparse model alone.

A point of the model is found again in a photograph that sees it about as another has: features change with the angle
between the two and with the ratio of their distances. A point counts by the better of its observers, so that the sum over the
points in the candidate's image is the number of matches to expect; they hold a pose where they are many and lie all over
the image. A logistic curve of both was fitted to the tracks of the two given sets of real photographs: which photographs share 15
points with the model of a few others (``python -m research.photographs.registers fit``; docs/results/real_photographs.md).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist
from scipy.special import expit

from nbv.config import MissionConfig
from nbv.geometry.visibility import camera_axes
from nbv.types import CandidatePool, Floats, PlanningState, SparseModel

MOST_POINTS = 800  # evenly chosen; more change no chance and take time
CELLS = 6  # along either side of the image
_BLOCK = 256  # points at a time


@dataclass(frozen=True)
class Calibration:
    """Log-odds that a photograph registers, and how fast features cease to match."""

    intercept: float = -3.1
    matches: float = 0.164  # of the logarithm of the matches to expect, and one
    cells: float = 2.252  # of the logarithm of the cells of the image that have some, and one
    angle_deg: float = 24.0  # between two views of a point: exp(-(angle/this)^2) of the matches are left
    octaves: float = 1.0  # the same of the ratio of their distances


CALIBRATION = Calibration()


def registration_chance(model: SparseModel, positions_m: Floats, config: MissionConfig) -> Floats:
    """(C,) chance that a photograph from each position (C, 3), aimed at the target, would register with the model."""
    fit = CALIBRATION
    matches, cells = expected_matches(model, positions_m, config)
    chance: Floats = expit(fit.intercept + fit.matches * np.log1p(matches) + fit.cells * np.log1p(cells))
    return chance


def expected_matches(
    model: SparseModel, positions_m: Floats, config: MissionConfig, fit: Calibration = CALIBRATION
) -> tuple[Floats, Floats]:
    """(C,) points that each position is expected to share with the model, and (C,) cells of its image, of 36, that have some."""
    count = len(model.points_m)
    if count == 0 or len(positions_m) == 0:
        return np.zeros(len(positions_m)), np.zeros(len(positions_m))
    chosen = np.unique(np.linspace(0, count - 1, min(count, MOST_POINTS)).astype(np.int64))
    part = model.select(chosen)
    share = _match_share(part, positions_m, fit)  # (P, C)
    right, down, forward = camera_axes(positions_m, np.array(config.target_m))
    camera = config.camera
    offset = part.points_m[:, None] - positions_m  # (P, C, 3)
    depth = np.einsum("pck,ck->pc", offset, forward)
    ahead = depth > 1e-6
    safe = np.where(ahead, depth, 1.0)
    across = np.einsum("pck,ck->pc", offset, right) / safe * camera.focal_px / camera.width_px + 0.5
    along = np.einsum("pck,ck->pc", offset, down) / safe * camera.focal_px / camera.height_px + 0.5
    inside = ahead & (across >= 0) & (across < 1) & (along >= 0) & (along < 1)
    share = np.where(inside, share, 0.0) * (count / len(chosen))
    column = np.where(inside, across * CELLS, 0).astype(np.int64)
    row = np.where(inside, along * CELLS, 0).astype(np.int64)
    cell = (np.arange(len(positions_m)) * CELLS + row) * CELLS + column
    in_cells = np.bincount(cell.ravel(), share.ravel(), len(positions_m) * CELLS**2)
    occupied = -np.expm1(-in_cells.reshape(-1, CELLS**2))  # chance of at least one match
    return share.sum(axis=0), occupied.sum(axis=1)


def _match_share(part: SparseModel, positions_m: Floats, fit: Calibration) -> Floats:
    """(P, C) share of a point's features that match between a position and the observer that sees the point most alike."""
    share = np.empty((len(part.points_m), len(positions_m)))
    for start in range(0, len(share), _BLOCK):
        offsets = part.track_offsets[start : start + _BLOCK + 1]
        points_m = part.points_m[start : start + _BLOCK].repeat(np.diff(offsets), axis=0)
        seen = part.camera_centers_m[part.track_cameras[offsets[0] : offsets[-1]]] - points_m
        views = positions_m - points_m[:, None]
        seen_m, view_m = np.linalg.norm(seen, axis=1)[:, None], np.linalg.norm(views, axis=2)
        cosine = np.einsum("tk,tck->tc", seen, views) / np.maximum(seen_m * view_m, 1e-12)
        angle_deg = np.rad2deg(np.arccos(np.clip(cosine, -1.0, 1.0)))
        octaves = np.log2(np.maximum(view_m, 1e-6) / np.maximum(seen_m, 1e-6))
        misfit = (angle_deg / fit.angle_deg) ** 2 + (octaves / fit.octaves) ** 2
        share[start : start + _BLOCK] = np.exp(
            -np.minimum.reduceat(misfit, offsets[:-1] - offsets[0], axis=0)
        )
    return share


def unregistered_m(state: PlanningState) -> Floats:
    """(U, 3) where the photographs were commanded that are not in the model: those that no registered camera is left for."""
    cameras_m, visited_m = state.model.camera_centers_m, state.visited_m
    if len(cameras_m) >= len(visited_m):
        return visited_m[:0]
    held = linear_sum_assignment(cdist(visited_m, cameras_m))[0]
    return np.delete(visited_m, held, axis=0)


def registrable(pool: CandidatePool, model: SparseModel, config: MissionConfig) -> CandidatePool:
    """The candidates that have ``pool.min_register_chance``; where none has it, the likeliest."""
    least = config.pool.min_register_chance
    if least == 0 or len(pool) == 0:
        return pool
    chance = registration_chance(model, pool.positions_m, config)
    keep = np.flatnonzero(chance >= min(least, chance.max()))
    return pool.select(keep, "registrable")
