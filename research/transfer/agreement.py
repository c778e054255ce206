"""Do two worlds prefer the same configurations? Rank correlation and regret, with bootstrap intervals.

Outcomes are oriented: larger is better. A *block* is a (rock, replicate); every rock counts the same.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.stats import rankdata

from nbv.types import Floats

Block = tuple[str, int]
Outcomes = Mapping[str, Mapping[Block, float]]  # by configuration and block
RESAMPLES = 4000
CONFIDENCE = 0.95


@dataclass(frozen=True)
class Estimate:
    """A number with its percentile bootstrap interval; None where there is none."""

    value: float | None
    low: float | None = None
    high: float | None = None


@dataclass(frozen=True)
class Agreement:
    """What the first world's outcomes say about the second's."""

    configurations: tuple[str, ...]  # that both worlds can rank
    blocks: int  # that all of them finished in both worlds
    spearman: Estimate
    chosen: str  # best of the first world; empty without a common block
    best: str  # best of the second
    regret: Estimate  # second world: its best minus the chosen one, metric's unit


def agreement(first: Outcomes, second: Outcomes, seed: int = 0) -> Agreement:
    """Compare the means of both worlds over the blocks that are complete in both.

    A configuration that finished fewer than half of the blocks that any other did in either world is left out, or it
    would take the blocks of all others with it. The bootstrap draws rocks, then replicates within them, the same for
    both worlds and all configurations; with few rocks it is too narrow.
    """
    names, blocks = _complete(first, second)
    if not blocks:
        return Agreement(names, 0, Estimate(None), "", "", Estimate(None))
    a, b = (np.array([[w[n][k] for k in blocks] for n in names]) for w in (first, second))
    own = _weights(blocks)
    mean_a, mean_b = a @ own, b @ own
    draws = _resampled_weights(blocks, seed)
    drawn_a, drawn_b = a @ draws, b @ draws  # (C, resamples)
    chosen = int(np.argmax(mean_a))
    return Agreement(
        names,
        len(blocks),
        _estimate(spearman(mean_a, mean_b), spearman(drawn_a, drawn_b), len(blocks)),
        names[chosen],
        names[int(np.argmax(mean_b))],
        _estimate(regret(mean_a, mean_b), regret(drawn_a, drawn_b), len(blocks)),
    )


def self_agreement(world: Outcomes) -> float | None:
    """Spearman correlation of a world's own means over odd and over even replicates.

    No other world can be expected to agree better than this; None with one replicate.
    """
    halves: list[Outcomes] = [
        {
            name: {(rock, k // 2): y for (rock, k), y in own.items() if k % 2 == odd}
            for name, own in world.items()
        }
        for odd in (0, 1)
    ]
    return agreement(halves[0], halves[1]).spearman.value


def spearman(first: Floats, second: Floats) -> Floats:
    """Spearman (1904): Pearson's correlation of the ranks, ties at their mean rank, along the first axis.

    ``first`` and ``second`` are (C,) or (C, D); NaN where either is constant or C < 2.
    """
    ranks = [rankdata(x, axis=0) for x in (first, second)]
    x, y = (r - r.mean(axis=0) for r in ranks)
    with np.errstate(invalid="ignore", divide="ignore"):
        rho: Floats = (x * y).sum(axis=0) / np.sqrt((x**2).sum(axis=0) * (y**2).sum(axis=0))
    return rho


def regret(first: Floats, second: Floats) -> Floats:
    """What choosing the first's largest entry costs in ``second``, along the first axis; 0 or more."""
    chosen = np.expand_dims(np.argmax(first, axis=0), 0)
    lost: Floats = second.max(axis=0) - np.take_along_axis(second, chosen, axis=0)[0]
    return lost


def _complete(first: Outcomes, second: Outcomes) -> tuple[tuple[str, ...], list[Block]]:
    names = [name for name in first if name in second]
    for world in (first, second):
        most = max((len(world[name]) for name in names), default=0)
        names = [name for name in names if 2 * len(world[name]) >= max(most, 1)]
    finished = [set(world[name]) for world in (first, second) for name in names]
    return tuple(names), sorted(set.intersection(*finished)) if finished else []


def _weights(blocks: list[Block]) -> Floats:
    rocks = [rock for rock, _ in blocks]
    return np.array([1.0 / (len(set(rocks)) * rocks.count(rock)) for rock in rocks])


def _resampled_weights(blocks: list[Block], seed: int) -> Floats:
    """(B, resamples) weights of the blocks in each bootstrap sample."""
    rng = np.random.default_rng(seed)
    rocks = sorted({rock for rock, _ in blocks})
    times = rng.multinomial(len(rocks), [1 / len(rocks)] * len(rocks), size=RESAMPLES)  # a rock was drawn
    weights = np.zeros((len(blocks), RESAMPLES))
    for i, rock in enumerate(rocks):
        own = [b for b, (r, _) in enumerate(blocks) if r == rock]
        drawn = rng.multinomial(times[:, i] * len(own), [1 / len(own)] * len(own))
        weights[own] = drawn.T / (len(rocks) * len(own))
    return weights


def _estimate(value: Floats, drawn: Floats, blocks: int) -> Estimate:
    if not np.isfinite(value):
        return Estimate(None)
    known = drawn[np.isfinite(drawn)]
    if blocks < 2 or not len(known):
        return Estimate(float(value))
    low, high = np.quantile(known, [(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2])
    return Estimate(float(value), float(low), float(high))
