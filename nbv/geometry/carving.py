"""What lines of sight leave of a solid: where a camera has looked through, there is nothing."""

from __future__ import annotations

import numpy as np
from scipy.spatial import ConvexHull

from nbv.types import Bools, Floats, Ints

CELLS = 16  # of a solid's height
STEP_CELLS = 0.7  # between the places of a line of sight that are looked up


def carved_top(hull: ConvexHull, points_m: Floats, cameras_m: Floats, seen_m: Floats) -> Floats:
    """(K, 3) the top of what lines of sight leave of a convex solid on the ground, column by column.

    ``hull`` is the solid. Points (N, 3) are parts of it whatever is said otherwise. Cameras (R, 3) have seen the places (R, 3):
    a line of sight is free up to a cell before its end. A cell is a sixteenth of the solid's height.
    """
    corners = hull.points[hull.vertices]
    cell_m = float(corners[:, 2].max()) / CELLS
    low = np.append(corners[:, :2].min(axis=0), 0.0)
    shape = np.maximum(np.ceil((corners.max(axis=0) - low) / cell_m).astype(int), 1)
    centers = low + (np.moveaxis(np.indices(tuple(shape)), 0, -1) + 0.5) * cell_m
    solid: Bools = (centers.reshape(-1, 3) @ hull.equations[:, :3].T <= -hull.equations[:, 3]).all(axis=1)
    solid[_cells(_along(cameras_m, seen_m, low, low + shape * cell_m, cell_m), low, shape, cell_m)] = False
    solid[_cells(points_m, low, shape, cell_m)] = True
    cells = solid.reshape(shape)
    columns = np.argwhere(cells.any(axis=2))
    top = shape[2] - np.argmax(cells[columns[:, 0], columns[:, 1], ::-1], axis=1)
    return np.column_stack([low[:2] + (columns + 0.5) * cell_m, top * cell_m])


def _along(cameras_m: Floats, seen_m: Floats, low: Floats, high: Floats, cell_m: float) -> Floats:
    """(K, 3) places of the lines of sight (R, 3) to (R, 3) within a box, none in the last cell's length."""
    along = seen_m - cameras_m
    length_m = np.linalg.norm(along, axis=1)
    along /= np.maximum(length_m, 1e-9)[:, None]
    along = np.where(np.abs(along) < 1e-12, 1e-12, along)  # parallel to a side: it is reached far away
    to_low, to_high = (low - cameras_m) / along, (high - cameras_m) / along
    first = np.maximum(np.minimum(to_low, to_high).max(axis=1), 0.0)
    last = np.minimum(np.maximum(to_low, to_high).min(axis=1), length_m - cell_m)
    crosses = last > first
    first, last = first[crosses], last[crosses]
    count = np.ceil((last - first) / (STEP_CELLS * cell_m)).astype(int)
    line = np.repeat(np.arange(len(count)), count)
    step = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    distance_m = first[line] + step * STEP_CELLS * cell_m
    places: Floats = cameras_m[crosses][line] + distance_m[:, None] * along[crosses][line]
    return places


def _cells(places_m: Floats, low: Floats, shape: Ints, cell_m: float) -> Ints:
    """(K,) index of the cell of each place (K, 3); of one beyond the box the nearest."""
    index = np.clip(np.floor((places_m - low) / cell_m).astype(int), 0, shape - 1)
    return np.ravel_multi_index(tuple(index.T), tuple(shape))
