"""The ground's height: a random surface of given rms and correlation length that fades to the flat plain."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.interpolate import RectBivariateSpline
from scipy.ndimage import gaussian_filter

from nbv.config import GroundConfig
from nbv.random_streams import keyed_rng
from nbv.rocks.noise import smooth_step
from nbv.types import Floats, Ints

RELIEF_HALF_EXTENT_M = 6.0  # of the square that has relief
FULL_M = 4.5  # from the middle; from there it fades
STEP_M = 0.05  # of the height field
FOOTPRINT_M = 0.6  # radius of a target's footprint: the mean height there is 0
FILLED_M = (0.8, 1.3)  # radii: inside the first no dip remains, outside the second all do


@dataclass(frozen=True, eq=False)
class Relief:
    """Heights at nodes ``STEP_M`` apart; flat triangles between them. Outside of the square the height is 0."""

    heights_m: Floats  # (N, N), row along y, column along x, first node at (-RELIEF_HALF_EXTENT_M, -RELIEF_HALF_EXTENT_M)

    def height_m(self, points_m: Floats) -> Floats:
        """(P,) height of the ground at points (P, 2 or more), exactly that of `mesh`."""
        cells = len(self.heights_m) - 1
        across = (np.asarray(points_m, dtype=float)[:, :2] + RELIEF_HALF_EXTENT_M) / STEP_M
        inside = ((across >= 0) & (across <= cells)).all(axis=1)
        column, row = np.clip(np.floor(across).astype(int), 0, cells - 1).T
        x, y = np.clip(across, 0, cells).T - np.stack([column, row])
        h = self.heights_m
        low, high = h[row, column], h[row + 1, column + 1]
        right, left = h[row, column + 1], h[row + 1, column]
        below = low + x * (right - low) + y * (high - right)
        above = low + x * (high - left) + y * (left - low)
        return np.where(inside, np.where(x >= y, below, above), 0.0)

    def mesh(self) -> tuple[Floats, Ints]:
        """Vertices (N * N, 3) and faces (F, 3), counter-clockwise seen from above."""
        n = len(self.heights_m)
        nodes = np.linspace(-RELIEF_HALF_EXTENT_M, RELIEF_HALF_EXTENT_M, n)
        x, y = np.meshgrid(nodes, nodes)
        corner = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
        lower = np.stack([corner, corner + 1, corner + n + 1], axis=1)
        upper = np.stack([corner, corner + n + 1, corner + n], axis=1)
        return np.stack([x, y, self.heights_m], axis=-1).reshape(-1, 3), np.concatenate([lower, upper])

    def raster_m(self, coordinates_m: Floats) -> Floats:
        """(M, M) smooth heights at the crossings of rising coordinates (M,) along y and x; for shading, which shows edges."""
        nodes = np.linspace(-RELIEF_HALF_EXTENT_M, RELIEF_HALF_EXTENT_M, len(self.heights_m))
        inside = np.abs(coordinates_m) <= RELIEF_HALF_EXTENT_M
        heights = np.zeros((len(coordinates_m), len(coordinates_m)))
        within = coordinates_m[inside]
        heights[np.ix_(inside, inside)] = RectBivariateSpline(nodes, nodes, self.heights_m)(within, within)
        return heights


def relief_of(ground: GroundConfig, seed: int) -> Relief | None:
    """The height field of a ``ground``, drawn from ``seed``; None where the ground is flat."""
    return _drawn_relief(ground.relief_m, ground.relief_length_m, seed) if ground.relief_m > 0 else None


@lru_cache(maxsize=4)
def _drawn_relief(relief_m: float, length_m: float, seed: int) -> Relief:
    """A Gaussian random field with autocorrelation ``exp(-(d / length_m)**2)``.

    White noise smoothed by a Gaussian of ``length_m / 2``, scaled to ``relief_m`` rms over the square of half side
    ``FULL_M`` and shifted so that its mean over the target's footprint is 0. Near the target dips are filled: regolith
    lies against a rock, and nothing of it hangs in the air.
    """
    nodes = np.linspace(
        -RELIEF_HALF_EXTENT_M, RELIEF_HALF_EXTENT_M, round(2 * RELIEF_HALF_EXTENT_M / STEP_M) + 1
    )
    white = keyed_rng("relief", seed).standard_normal((len(nodes), len(nodes)))
    smooth = gaussian_filter(white, length_m / 2 / STEP_M, mode="wrap")
    full = np.ix_(np.abs(nodes) <= FULL_M, np.abs(nodes) <= FULL_M)
    height = relief_m * (smooth - smooth[full].mean()) / smooth[full].std()
    x, y = np.meshgrid(nodes, nodes)
    radius = np.hypot(x, y)
    height -= height[radius <= FOOTPRINT_M].mean()
    near, far = FILLED_M
    height = np.maximum(height, height * smooth_step((radius - near) / (far - near)))
    edge = np.maximum(np.abs(x), np.abs(y))
    height *= smooth_step((RELIEF_HALF_EXTENT_M - edge) / (RELIEF_HALF_EXTENT_M - FULL_M))
    height.setflags(write=False)
    return Relief(height)
