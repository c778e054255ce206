"""Where the variance of an objective comes from: configurations, rocks, replicates.

The design: every configuration flies every rock with every replicate. Replicate k on a rock is the same draw
of arrival errors and sensor noise for all configurations, so it is a block that they share, nested in the
rock:

    y[c, r, k] = mu + C[c] + R[r] + (CR)[c, r] + B[r, k] + e[c, r, k]

with independent, centred random effects. Estimates are the analysis of variance's (method of moments: mean
squares set equal to their expectations), unbiased, and therefore possibly negative.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy import stats

from nbv.types import Floats

MIN_CONFIGURATIONS = 3


@dataclass(frozen=True)
class VarianceComponents:
    """Variances in the square of the objective's unit, as estimated (a negative one means "about zero")."""

    configuration: float  # of the configurations' means over all rocks of the kind
    configuration_rock: float  # configurations that are good on one rock and not on another
    rock: float
    replicate: float  # shared by all configurations: a lucky draw on a rock
    residual: float  # what is left between two missions of one configuration on one rock
    within: float  # replicate + residual, measured directly: two replicates of one configuration and rock
    configurations: int
    rocks: int
    replicates: int
    mean_square_configuration: float

    @property
    def between(self) -> float:
        """Variance between configurations of the true mean over *these* rocks: what tuning on them sees.

        C + CR / K, estimated as one (mean square of the configurations against the residual's).
        """
        return (self.mean_square_configuration - self.residual) / (self.rocks * self.replicates)

    @property
    def noise(self) -> float:
        """Variance of one configuration's mean over the rocks, flown once on each."""
        return self.within / self.rocks

    @property
    def paired_noise(self) -> float:
        """The same when configurations are compared on common replicates: the shared draw cancels."""
        return self.residual / self.rocks

    @property
    def signal_to_noise(self) -> float:
        """``between / noise``, not below 0; infinite without noise."""
        return _ratio(self.between, self.noise)

    @property
    def paired_signal_to_noise(self) -> float:
        """``between / paired_noise``, not below 0."""
        return _ratio(self.between, self.paired_noise)

    @property
    def unseen_signal_to_noise(self) -> float:
        """As ``signal_to_noise``, counting only what carries over to other rocks (C without CR).

        NaN with one rock, where the two cannot be told apart.
        """
        if math.isnan(self.configuration_rock):
            return math.nan
        return _ratio(self.configuration, self.noise)

    def signal_to_noise_interval(self, confidence: float = 0.95) -> tuple[float, float]:
        """Interval of ``signal_to_noise`` from the F distribution.

        Exact for normal effects when there is no shared replicate variance; approximate otherwise (the shared
        part's estimate is taken as known).
        """
        tail = (1 - confidence) / 2
        degrees = (
            self.configurations - 1,
            self.configurations * self.rocks * (self.replicates - 1),
        )
        bounds = []
        for quantile in (1 - tail, tail):
            mean_square = self.mean_square_configuration / stats.f.ppf(quantile, *degrees)
            bounds.append(_ratio((mean_square - self.residual) / self.replicates, self.within))
        return bounds[0], bounds[1]

    def shares(self) -> dict[str, float]:
        """Share of each effect in the variance of a single mission, negative estimates counted as 0."""
        parts = {
            "configuration": self.configuration,
            "configuration x rock": self.configuration_rock,
            "rock": self.rock,
            "replicate": self.replicate,
            "residual": self.residual,
        }
        positive = {name: max(0.0, value) for name, value in parts.items()}
        total = sum(positive.values())
        return {name: value / total if total > 0 else 0.0 for name, value in positive.items()}


def _ratio(signal: float, noise: float) -> float:
    if signal <= 0:
        return 0.0
    return signal / noise if noise > 0 else math.inf


def variance_components(values: Floats) -> VarianceComponents:
    """Split the variance of a complete, balanced design.

    Parameters
    ----------
    values
        (C, K, R): configurations, rocks, replicates; finite.

    Raises
    ------
    ValueError
        Fewer than 2 configurations or replicates, or a value is missing. One rock is possible: its effect and
        the interaction are then NaN, and ``configuration`` holds C + CR.
    """
    y = np.asarray(values, dtype=float)
    if y.ndim != 3 or y.shape[0] < 2 or y.shape[1] < 1 or y.shape[2] < 2:
        raise ValueError(f"need (C >= 2, K >= 1, R >= 2) values, got {y.shape}")
    if not np.isfinite(y).all():
        raise ValueError("a value is missing; take the largest complete part of the design")
    c, k, r = y.shape
    mean = y.mean()
    by_configuration, by_rock = y.mean(axis=(1, 2)), y.mean(axis=(0, 2))
    by_cell, by_block = y.mean(axis=2), y.mean(axis=0)  # (C, K), (K, R)
    ms_configuration = k * r * float(((by_configuration - mean) ** 2).sum()) / (c - 1)
    ms_block = c * float(((by_block - by_rock[:, None]) ** 2).sum()) / (k * (r - 1))
    left = y - by_cell[:, :, None] - by_block[None] + by_rock[None, :, None]
    ms_residual = float((left**2).sum()) / (k * (c - 1) * (r - 1))
    within = float(((y - by_cell[:, :, None]) ** 2).sum()) / (c * k * (r - 1))
    configuration, interaction, rock = (ms_configuration - ms_residual) / r, math.nan, math.nan
    if k > 1:
        cross = by_cell - by_configuration[:, None] - by_rock[None] + mean
        ms_cross = r * float((cross**2).sum()) / ((c - 1) * (k - 1))
        ms_rock = c * r * float(((by_rock - mean) ** 2).sum()) / (k - 1)
        configuration = (ms_configuration - ms_cross) / (k * r)
        interaction = (ms_cross - ms_residual) / r
        rock = (ms_rock - ms_cross - ms_block + ms_residual) / (c * r)
    return VarianceComponents(
        configuration,
        interaction,
        rock,
        (ms_block - ms_residual) / c,
        ms_residual,
        within,
        c,
        k,
        r,
        ms_configuration,
    )


def largest_complete(values: Floats) -> tuple[Floats, list[int], int]:
    """The complete part of a design with holes: whole configurations, and the first replicates.

    Parameters
    ----------
    values
        (C, K, R), NaN where a mission failed or has not been flown.

    Returns
    -------
    values, configurations, replicates
        (C', K, R') without NaN, the indices of the configurations kept, R'. Of all possible R' >= 2 the one
        with the most missions; C' is 0 when none leaves ``MIN_CONFIGURATIONS`` configurations.
    """
    best: tuple[Floats, list[int], int] = (np.empty((0, values.shape[1], 0)), [], 0)
    for count in range(values.shape[2], 1, -1):
        part = values[:, :, :count]
        kept = [i for i in range(len(part)) if np.isfinite(part[i]).all()]
        if len(kept) >= MIN_CONFIGURATIONS and len(kept) * count > len(best[1]) * best[2]:
            best = (part[kept], kept, count)
    return best


def pooled_variance(groups: list[Floats], confidence: float = 0.95) -> tuple[float, float, float, int] | None:
    """``(variance, low, high, degrees)`` pooled within groups, chi-squared interval; None without replication."""
    full = [np.asarray(g, dtype=float) for g in groups if len(g) > 1]
    degrees = sum(len(g) - 1 for g in full)
    if degrees == 0:
        return None
    squares = sum(float(((g - g.mean()) ** 2).sum()) for g in full)
    tail = (1 - confidence) / 2
    return (
        squares / degrees,
        squares / float(stats.chi2.ppf(1 - tail, degrees)),
        squares / float(stats.chi2.ppf(tail, degrees)),
        degrees,
    )
