"""What lines of sight leave of a solid: where a camera has looked through, there is nothing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter
from scipy.spatial import ConvexHull

from nbv.types import Bools, Floats, Ints

CELLS = 16  # of a solid's height
OFF_SURFACE_CELLS = 1.5  # from a sample to where its lines of sight begin: its own cube hides nothing
STEP_CELLS = 0.7  # between the places of a line of sight that are looked up


@dataclass(frozen=True)
class Solid:
    """What may be solid, in cubes: seen there, or not looked through by any camera."""

    low_m: Floats  # (3,) the first cube's lowest corner
    cell_m: float
    cells: Bools  # (X, Y, Z)

    def surface(self, known_m: Floats, count: int, rng: np.random.Generator) -> tuple[Floats, Floats]:
        """At most ``count`` samples (S, 3) of where it meets free space, and their unit normals (S, 3).

        A sample is the mean of the known places (K, 3) in its cube, and the cube's middle where there is none.
        """
        padded = np.pad(self.cells, 1)
        padded[:, :, 0] = padded[:, :, 1]  # it stands on the ground
        free = np.zeros_like(self.cells)
        for axis in range(3):
            for step in (-1, 1):
                free |= ~np.roll(padded, step, axis)[1:-1, 1:-1, 1:-1]
        index = np.argwhere(self.cells & free)
        if len(index) > count:
            index = index[np.sort(rng.choice(len(index), count, replace=False))]
        smooth = gaussian_filter(padded.astype(np.float32), 1.0, mode="nearest")
        at = tuple((index + 1).T)
        normals = -np.stack([np.gradient(smooth, axis=axis)[at] for axis in range(3)], axis=1).astype(float)
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
        shape = np.array(self.cells.shape)
        flat = np.ravel_multi_index(tuple(index.T), self.cells.shape)
        found = _cells(known_m, self.low_m, shape, self.cell_m)
        here = np.bincount(found, minlength=self.cells.size)[flat]
        sums = [np.bincount(found, known_m[:, k], minlength=self.cells.size)[flat] for k in range(3)]
        middles = self.low_m + (index + 0.5) * self.cell_m
        means = np.stack(sums, axis=1) / np.maximum(here, 1)[:, None]
        return np.where(here[:, None] > 0, means, middles), normals

    def hides(self, samples_m: Floats, normals: Floats, cameras_m: Floats, ask: Bools) -> Bools:
        """(V, S) whether it stands between each camera (V, 3) and each sample (S, 3), where ``ask`` (V, S)."""
        view, sample = np.nonzero(ask)
        start = samples_m + OFF_SURFACE_CELLS * self.cell_m * normals
        along = (cameras_m[view] - start[sample]).astype(np.float32)
        along /= np.linalg.norm(along, axis=1, keepdims=True)  # a cell's length at each step
        place = ((start[sample] - self.low_m) / self.cell_m).astype(np.float32)
        shape, cells = np.array(self.cells.shape), self.cells.ravel()
        left, blocked = np.arange(len(view)), np.zeros(len(view), dtype=bool)
        while len(left):
            index = np.floor(place).astype(np.int32)
            inside = ((index >= 0) & (index < shape)).all(axis=1)
            leaves = ((index < 0) & (along <= 0) | (index >= shape) & (along >= 0)).any(axis=1)
            row = (index[:, 0] * shape[1] + index[:, 1]) * shape[2] + index[:, 2]
            hit = inside & cells[np.where(inside, row, 0)]
            blocked[left[hit]] = True
            on = ~hit & ~leaves
            left, place, along = left[on], place[on] + along[on], along[on]
        hidden = np.zeros_like(ask)
        hidden[view, sample] = blocked
        return hidden


def carved(
    hull: ConvexHull, points_m: Floats, cameras_m: Floats, seen_m: Floats, cells: int = CELLS
) -> Solid:
    """What lines of sight leave of a convex solid on the ground.

    ``hull`` is the solid. Points (N, 3) are parts of it whatever is said otherwise. Cameras (R, 3) have seen the places (R, 3):
    a line of sight is free up to a cell before its end. The solid is ``cells`` cells high.
    """
    corners = hull.points[hull.vertices]
    cell_m = float(corners[:, 2].max()) / cells
    low = np.append(corners[:, :2].min(axis=0), 0.0)
    shape = np.maximum(np.ceil((corners.max(axis=0) - low) / cell_m).astype(int), 1)
    centers = low + (np.moveaxis(np.indices(tuple(shape)), 0, -1) + 0.5) * cell_m
    solid: Bools = (centers.reshape(-1, 3) @ hull.equations[:, :3].T <= -hull.equations[:, 3]).all(axis=1)
    solid[_cells(_along(cameras_m, seen_m, low, low + shape * cell_m, cell_m), low, shape, cell_m)] = False
    solid[_cells(points_m, low, shape, cell_m)] = True
    return Solid(low, cell_m, solid.reshape(shape))


def carved_top(hull: ConvexHull, points_m: Floats, cameras_m: Floats, seen_m: Floats) -> Floats:
    """(K, 3) the top of what lines of sight leave of a convex solid (`carved`), column by column."""
    solid = carved(hull, points_m, cameras_m, seen_m)
    cells = solid.cells
    columns = np.argwhere(cells.any(axis=2))
    top = cells.shape[2] - np.argmax(cells[columns[:, 0], columns[:, 1], ::-1], axis=1)
    return np.column_stack([solid.low_m[:2] + (columns + 0.5) * solid.cell_m, top * solid.cell_m])


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
