"""Means and paired differences over rocks and replicates, with intervals that say what they generalise to."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy import stats

Method = Literal["auto", "rocks", "replicates", "bootstrap"]
# With fewer rocks a t-interval over rocks says little but "unknown".
MIN_ROCKS = 3


@dataclass(frozen=True)
class Interval:
    """A mean in which every rock counts the same, and its confidence interval.

    ``method`` is ``rocks`` (t-interval over rock means: generalises to unseen rocks of the same kind),
    ``replicates`` (rocks taken as fixed, pooled variance between replicates: generalises to new replicates on
    these rocks only), ``bootstrap`` (rocks, then replicates within them, resampled), or ``none`` (too few
    missions for any; the bounds are None).
    """

    mean: float
    low: float | None
    high: float | None
    rocks: int
    missions: int
    method: str
    confidence: float = 0.95

    @property
    def excludes_zero(self) -> bool:
        """Whether 0 lies outside the interval."""
        return self.low is not None and self.high is not None and (self.low > 0 or self.high < 0)


def mean_interval(
    by_rock: Mapping[str, Sequence[float]],
    method: Method = "auto",
    confidence: float = 0.95,
    seed: int = 0,
    resamples: int = 4000,
) -> Interval | None:
    """Mean over rocks of the mean over replicates; None without any value.

    ``auto`` takes ``rocks`` from three rocks on, else ``replicates``, else no interval. The bootstrap is there
    for skewed metrics; with few rocks it is too narrow (the tests measure by how much).
    """
    groups = [np.asarray(values, dtype=float) for values in by_rock.values() if len(values)]
    if not groups:
        return None
    rocks, missions = len(groups), int(sum(len(g) for g in groups))
    means = np.array([g.mean() for g in groups])
    mean = float(means.mean())
    if method == "auto":
        method = "rocks" if rocks >= MIN_ROCKS else "replicates"
    quantile = 0.5 + confidence / 2
    if method == "rocks" and rocks >= 2:
        half = stats.t.ppf(quantile, rocks - 1) * float(means.std(ddof=1)) / math.sqrt(rocks)
    elif method == "replicates" and missions > rocks:
        degrees = missions - rocks
        pooled = sum(float(((g - g.mean()) ** 2).sum()) for g in groups) / degrees
        error = math.sqrt(pooled * sum(1 / len(g) for g in groups)) / rocks
        half = stats.t.ppf(quantile, degrees) * error
    elif method == "bootstrap" and missions > 1:
        rng = np.random.default_rng(seed)
        draws = np.empty(resamples)
        for i in range(resamples):
            chosen = rng.integers(rocks, size=rocks)
            draws[i] = np.mean([rng.choice(groups[j], len(groups[j])).mean() for j in chosen])
        low, high = np.quantile(draws, [1 - quantile, quantile])
        return Interval(mean, float(low), float(high), rocks, missions, "bootstrap", confidence)
    else:
        return Interval(mean, None, None, rocks, missions, "none", confidence)
    return Interval(mean, mean - half, mean + half, rocks, missions, method, confidence)


@dataclass(frozen=True)
class PairedDifference:
    """Strategy minus reference on the (rock, replicate) pairs that both finished."""

    interval: Interval  # of the difference, metric's unit
    pairs: int
    wins: int  # pairs on which the strategy is the better one
    losses: int
    wilcoxon_p: float | None  # two-sided signed-rank test over pairs; takes pairs as independent
    sign_p: float | None  # two-sided exact sign test over rock means, ties left out

    @property
    def ties(self) -> int:
        """Pairs without a difference."""
        return self.pairs - self.wins - self.losses

    @property
    def exactly_zero(self) -> bool:
        """Whether no pair differs at all."""
        return self.ties == self.pairs


def paired_difference(
    strategy: Mapping[tuple[str, int], float],
    reference: Mapping[tuple[str, int], float],
    higher_is_better: bool,
    method: Method = "auto",
    confidence: float = 0.95,
) -> PairedDifference | None:
    """Differences on common (rock, replicate) pairs; None when there are none."""
    common = sorted(set(strategy) & set(reference))
    by_rock: dict[str, list[float]] = {}
    for rock, replicate in common:
        by_rock.setdefault(rock, []).append(strategy[rock, replicate] - reference[rock, replicate])
    interval = mean_interval(by_rock, method, confidence)
    if interval is None:
        return None
    differences = np.array([d for values in by_rock.values() for d in values])
    gains = differences if higher_is_better else -differences
    rock_signs = np.sign([np.mean(values) for values in by_rock.values()])
    moved = int(np.count_nonzero(rock_signs))
    sign_p = float(stats.binomtest(int((rock_signs > 0).sum()), moved).pvalue) if moved else None
    wilcoxon_p = None
    if np.count_nonzero(differences) >= 2:
        wilcoxon_p = float(stats.wilcoxon(differences).pvalue)
    return PairedDifference(
        interval, len(common), int((gains > 0).sum()), int((gains < 0).sum()), wilcoxon_p, sign_p
    )
