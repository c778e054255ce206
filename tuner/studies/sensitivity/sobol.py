"""Variance-based sensitivity: Sobol indices of a cheap function on the unit cube.

The estimator is ``scipy.stats.sobol_indices`` (Saltelli et al., Computer Physics Communications 181, 2010); a pair of
inputs enters it as one more input, whose first-order index is the closed index of the pair. Inputs are independent and
uniform, so importance is relative to the search space's bounds and scales.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats
from scipy.stats import qmc

from nbv.types import Floats

Pair = tuple[int, int]


@dataclass(frozen=True)
class SobolDesign:
    """Where the function is to be evaluated: two samples, and crosses of the two."""

    a: Floats  # (n, d)
    b: Floats  # (n, d)
    pairs: tuple[Pair, ...]

    @property
    def points(self) -> Floats:
        """((2 + d + len(pairs)) n, d): A, B, A with each column from B, A with each pair's columns from B."""
        blocks = [self.a, self.b]
        for columns in [*((i,) for i in range(self.a.shape[1])), *self.pairs]:
            mixed = self.a.copy()
            mixed[:, columns] = self.b[:, columns]
            blocks.append(mixed)
        return np.concatenate(blocks)


@dataclass(frozen=True)
class SobolIndices:
    """Shares of the function's variance."""

    first: Floats  # (..., d) of each input alone
    total: Floats  # (..., d) of each input with all its interactions
    second: Floats  # (..., p) of each pair's interaction, without the two first-order shares
    variance: Floats  # (...,) of the function


def sobol_design(dimension: int, n: int, seed: int, pairs: Sequence[Pair] = ()) -> SobolDesign:
    """Return two independent samples of ``n`` points from one scrambled Sobol sequence.

    Parameters
    ----------
    dimension
        Number of parameters.
    n
        Points per sample, a power of two.
    seed
        The seed of the scrambling.
    pairs
        The pairs of parameters whose joint indices are estimated.
    """
    sample = qmc.Sobol(2 * dimension, scramble=True, rng=seed).random_base2(int(np.log2(n)))
    return SobolDesign(sample[:, :dimension], sample[:, dimension:], tuple(pairs))


def sobol_indices(design: SobolDesign, values: Floats, rows: np.ndarray | None = None) -> SobolIndices:
    """Return the indices from the function's values at ``design.points``.

    Parameters
    ----------
    values
        (..., (2 + d + p) n); leading axes are several functions at once.
    rows
        (n',) rows of the two samples to use (a bootstrap draw); default all.

    Returns
    -------
    Indices with the leading axes of ``values``; NaN where the function does not vary.
    """
    n, d = design.a.shape
    outputs = values.shape[:-1]
    y = np.asarray(values, dtype=float).reshape(-1, values.shape[-1] // n, n)
    y = y if rows is None else y[..., rows]
    a, b, crosses = y[:, 0], y[:, 1], y[:, 2:]
    variance = np.concatenate([a, b], axis=-1).var(axis=-1)
    with np.errstate(invalid="ignore", divide="ignore"):
        found = stats.sobol_indices(func={"f_A": a, "f_B": b, "f_AB": np.moveaxis(crosses, 1, 0)}, n=n)
    closed, total = (np.reshape(part, crosses.shape[:2]) for part in (found.first_order, found.total_order))
    first = closed[:, :d]
    pairs = np.array(design.pairs, dtype=int).reshape(-1, 2)
    second = closed[:, d:] - first[:, pairs[:, 0]] - first[:, pairs[:, 1]]
    flat = variance <= 1e-15 * np.maximum(1.0, np.abs(y).max(axis=(-2, -1))) ** 2
    shares = (np.where(flat[:, None], np.nan, part) for part in (first, total[:, :d], second))
    first, total, second = (part.reshape(*outputs, part.shape[-1]) for part in shares)
    return SobolIndices(first, total, second, variance.reshape(outputs))


def bootstrap_interval(
    design: SobolDesign,
    values: Floats,
    seed: int,
    resamples: int = 200,
    confidence: float = 0.95,
) -> tuple[SobolIndices, SobolIndices]:
    """Return lower and upper bounds of all indices, from resampled rows of the design.

    With several functions (a leading axis) every draw takes one of them too: the interval then covers both the
    finite sample and what the functions disagree about, e.g. draws from a posterior.

    Parameters
    ----------
    design
        The points.
    values
        (..., (2 + d + p) n) of the function, or functions, at them.
    seed
        The seed of the draws.
    resamples
        How many draws.
    confidence
        The interval's probability.
    """
    rng = np.random.default_rng(seed)
    n = len(design.a)
    draws = []
    for i in range(resamples):
        y = values if values.ndim == 1 else values[i % len(values)]
        draws.append(sobol_indices(design, y, rng.integers(n, size=n)))
    tail = 50 * (1 - confidence)

    def bound(percent: float) -> SobolIndices:
        fields = ("first", "total", "second", "variance")
        parts = (np.nanpercentile(np.array([getattr(x, f) for x in draws]), percent, axis=0) for f in fields)
        return SobolIndices(*parts)

    return bound(tail), bound(100 - tail)


def main_effect_map(
    function: Callable[[Floats], Floats], dimension: int, pair: Pair, grid: int, n: int, seed: int
) -> Floats:
    """Return the (grid, grid) mean of ``function`` over all other inputs; [i, j] is at cell centres of the pair's inputs.

    Parameters
    ----------
    function
        Of (m, d) positions in the unit cube: (m,).
    dimension
        Number of inputs d.
    pair
        The two inputs of the map.
    grid
        Cells along each.
    n
        Points over which the other inputs are averaged, a power of two.
    seed
        The seed of these points.
    """
    others = qmc.Sobol(dimension, scramble=True, rng=seed).random_base2(int(np.log2(n)))
    centres = (np.arange(grid) + 0.5) / grid
    out = np.empty((grid, grid))
    for i, u in enumerate(centres):
        block = np.repeat(others[None], grid, axis=0)  # (grid, n, d)
        block[:, :, pair[0]] = u
        block[:, :, pair[1]] = centres[:, None]
        out[i] = function(block.reshape(-1, dimension)).reshape(grid, n).mean(axis=1)
    return out
