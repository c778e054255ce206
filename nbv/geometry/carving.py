"""What lines of sight leave of a solid: where a camera has looked through, there is nothing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from nbv.types import Bools, Floats, Ints

OFF_SURFACE_CELLS = 1.5  # from a sample to where its lines of sight begin: its own cube hides nothing
STEP_CELLS = 0.7  # between the places of a line of sight that are looked up
_AROUND = 2  # cells of free space: a line of sight begins in them or in the solid


@dataclass(frozen=True)
class Solid:
    """What may be solid, in cubes: seen there, or not looked through by any camera."""

    low_m: Floats  # (3,) the first cube's lowest corner
    cell_m: float
    cells: Bools  # (X, Y, Z)

    def surface(self, known_m: Floats, count: int, rng: np.random.Generator) -> tuple[Floats, Floats, Bools]:
        """At most ``count`` samples (S, 3) of where it meets free space, their unit normals (S, 3), and whether these are known (S,).

        A sample is the mean of the known places (K, 3) in its cube, and the cube's middle where there is none. It is known where its
        cube or one beside it holds a place.
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
        smooth = scipy.ndimage.gaussian_filter(padded.astype(np.float32), 1.0, mode="nearest")
        at = tuple((index + 1).T)
        normals = -np.stack([np.gradient(smooth, axis=axis)[at] for axis in range(3)], axis=1).astype(float)
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
        shape = np.array(self.cells.shape)
        flat = np.ravel_multi_index(tuple(index.T), self.cells.shape)
        cell_of = _cells(known_m, self.low_m, shape, self.cell_m)
        places = np.bincount(cell_of, minlength=self.cells.size)
        shown = scipy.ndimage.binary_dilation(places.reshape(self.cells.shape) > 0)[tuple(index.T)]
        here = places[flat]
        sums = [np.bincount(cell_of, known_m[:, k], minlength=self.cells.size)[flat] for k in range(3)]
        middles = self.low_m + (index + 0.5) * self.cell_m
        means = np.stack(sums, axis=1) / np.maximum(here, 1)[:, None]
        return np.where(here[:, None] > 0, means, middles), normals, shown

    def cameras_at(self, samples_m: Floats, places_m: Floats, cameras: Ints) -> Ints:
        """(S,) how many cameras have a place (K, 3), which ``cameras`` (K,) says whose it is, in the cube of each sample (S, 3)."""
        shape = np.array(self.cells.shape)
        count = int(cameras.max(initial=0)) + 1
        pairs = np.unique(_cells(places_m, self.low_m, shape, self.cell_m) * count + cameras)
        by_cell = np.bincount(pairs // count, minlength=self.cells.size)
        return by_cell[_cells(samples_m, self.low_m, shape, self.cell_m)]

    def hides(self, samples_m: Floats, normals: Floats, cameras_m: Floats, ask: Bools) -> Bools:
        """(V, S) whether it stands between each camera (V, 3) and each sample (S, 3), where ``ask`` (V, S)."""
        view, sample = np.nonzero(ask)
        start = samples_m + OFF_SURFACE_CELLS * self.cell_m * normals
        along = (cameras_m[view] - start[sample]).T.astype(np.float32)
        along /= np.sqrt((along**2).sum(axis=0))  # a cell's length at each step
        cells = np.pad(self.cells, _AROUND)
        shape = np.array(cells.shape)[:, None]
        place = ((start - self.low_m) / self.cell_m + _AROUND).T.astype(np.float32)[:, sample]
        left, blocked, flat = np.arange(len(view)), np.zeros(len(view), dtype=bool), cells.ravel()
        while len(left):
            index = place.astype(np.int32)
            on = np.flatnonzero((index.view(np.uint32) < shape).all(axis=0))  # a negative one is a large one
            hit = flat[(index[0, on] * shape[1] + index[1, on]) * shape[2] + index[2, on]]
            blocked[left[on[hit]]] = True
            on = on[~hit]
            left, along = left[on], along[:, on]
            place = place[:, on] + along
        hidden = np.zeros_like(ask)
        hidden[view, sample] = blocked
        return hidden


def carved(
    hull: scipy.spatial.ConvexHull,
    points_m: Floats,
    cameras_m: Floats,
    seen_m: Floats,
    cells: int,
    *,
    fewest: int = 1,
    share: float = 0.0,
) -> Solid:
    """What lines of sight leave of a convex solid on the ground.

    ``hull`` is the solid. Cameras (R, 3) have seen the places (R, 3): a line of sight is free up to a cell before its end. A
    cell with points (N, 3) is part of the solid whatever lines cross it, if it has ``fewest`` of them and at least ``share`` times as many
    as lines: wrong depths are scattered. The solid is ``cells`` cells high.
    """
    corners = hull.points[hull.vertices]
    cell_m = float(corners[:, 2].max()) / cells
    low = np.append(corners[:, :2].min(axis=0), 0.0)
    shape = np.maximum(np.ceil((corners.max(axis=0) - low) / cell_m).astype(int), 1)
    solid = _inside(hull, low, shape, cell_m)
    lines = np.bincount(_along(cameras_m, seen_m, low, shape, cell_m), minlength=solid.size)
    points = np.bincount(_cells(points_m, low, shape, cell_m), minlength=solid.size)
    solid[lines > 0] = False
    solid[points >= np.maximum(fewest, share * lines)] = True
    return Solid(low, cell_m, solid.reshape(shape))


def _inside(hull: scipy.spatial.ConvexHull, low: Floats, shape: Ints, cell_m: float) -> Bools:
    """(X * Y * Z,) which cells' centres lie in a convex solid: between its facets, column by column."""
    x, y, z = (low[k] + (np.arange(shape[k]) + 0.5) * cell_m for k in range(3))
    columns = np.stack([*np.meshgrid(x, y, indexing="ij"), np.ones((len(x), len(y)))], axis=-1).reshape(-1, 3)
    slope = hull.equations[:, 2]
    beyond = columns @ hull.equations[:, [0, 1, 3]].T  # (X * Y, F) of a facet at z = 0
    with np.errstate(divide="ignore", invalid="ignore"):
        crossing = -beyond / slope
    above = np.where(slope < 0, crossing, -np.inf).max(axis=1)
    below = np.where(slope > 0, crossing, np.inf).min(axis=1)
    below[(beyond[:, slope == 0] > 0).any(axis=1)] = -np.inf
    inside: Bools = (z >= above[:, None]) & (z <= below[:, None])
    return inside.ravel()


def _along(cameras_m: Floats, seen_m: Floats, low: Floats, shape: Ints, cell_m: float) -> Ints:
    """(K,) indices of the cells of a box that the lines of sight (R, 3) to (R, 3) cross, none in the last cell's length."""
    along = seen_m - cameras_m
    length_m = np.linalg.norm(along, axis=1)
    along /= np.maximum(length_m, 1e-9)[:, None]
    along = np.where(np.abs(along) < 1e-12, 1e-12, along)  # parallel to a side: it is reached far away
    to_low, to_high = (low - cameras_m) / along, (low + shape * cell_m - cameras_m) / along
    first = np.maximum(np.minimum(to_low, to_high).max(axis=1), 0.0)
    last = np.minimum(np.maximum(to_low, to_high).min(axis=1), length_m - cell_m)
    crosses = last > first
    first, last = first[crosses], last[crosses]
    count = np.ceil((last - first) / (STEP_CELLS * cell_m)).astype(int)
    step = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    distance_m = np.repeat(first, count) + step * STEP_CELLS * cell_m
    cell = np.zeros(len(step), dtype=np.int64)
    for k in range(3):  # an axis at a time is twice as fast as rows of three
        place_m = np.repeat(cameras_m[crosses, k], count) + distance_m * np.repeat(along[crosses, k], count)
        index = ((place_m - low[k]) / cell_m).astype(np.int64)
        cell = cell * shape[k] + np.clip(index, 0, shape[k] - 1)
    return cell


def _cells(places_m: Floats, low: Floats, shape: Ints, cell_m: float) -> Ints:
    """(K,) index of the cell of each place (K, 3); of one beyond the box the nearest."""
    index = np.clip(np.floor((places_m - low) / cell_m).astype(int), 0, shape - 1)
    return np.ravel_multi_index(tuple(index.T), tuple(shape))
