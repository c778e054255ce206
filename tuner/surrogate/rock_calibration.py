"""Does the surrogate know something about a rock that it has not seen? Leave-one-rock-out.

The purpose of tuning is a configuration for rocks nobody has flown, so this is the check that matters: every rock in
turn is predicted from the others. A rock's own level (easy or hard) is not predictable and not needed, so it is
taken out, under every condition: what is checked is which configurations do better on it, and by how much.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from tuner.problem.observations import Observation
from tuner.surrogate.model import RockMeanGP
from tuner.surrogate.numerics import NORMAL_95

AT_ONCE = 500  # missions, of which nothing is asked jointly
MIN_MISSIONS = 4  # on a rock: its level is estimated from them


@dataclass(frozen=True)
class RockCheck:
    """One rock, predicted from the others."""

    rock: str
    missions: int
    inside_95: float  # share of its missions inside their 95 % interval
    z_sd: float  # of the standardised residuals; 1 is ideal
    spearman: float | None  # measured against predicted; None where either is constant


def leave_one_rock_out(
    observations: Sequence[Observation],
    rocks: Sequence[str],
    build: Callable[[Sequence[Observation], Sequence[str]], RockMeanGP],
) -> list[RockCheck]:
    """One check per rock that has `MIN_MISSIONS` feasible missions; hyperparameters are fitted anew without it.

    ``build`` makes the surrogate of some observations on some rocks. Empty where fewer than two rocks have missions.
    """
    feasible = [o for o in observations if o.feasible]
    checks = []
    for rock in rocks:
        own = [o for o in feasible if o.rock == rock]
        others = [o for o in feasible if o.rock != rock]
        if len(own) < MIN_MISSIONS or not others:
            continue
        model = build(others, [r for r in rocks if r != rock])
        parts = [
            model.posterior([o.values for o in own[begin : begin + AT_ONCE]])
            for begin in range(0, len(own), AT_ONCE)
        ]
        means, sds = (np.concatenate([getattr(part, name) for part in parts]) for name in ("mean", "sd"))
        measured = np.array([o.outcome for o in own], dtype=float)
        conditions = np.array([o.condition for o in own])
        residual, freedom, gain = measured - means, np.ones(len(own)), measured.copy()
        for condition in set(conditions):
            inside = conditions == condition
            residual[inside] -= residual[inside].mean()
            gain[inside] -= gain[inside].mean()
            freedom[inside] -= 1.0 / inside.sum()  # the level took one degree of freedom
        told = freedom > 0  # a mission alone under its condition says nothing
        if told.sum() < MIN_MISSIONS:
            continue
        variance = sds**2 + model.noise_sd**2 + (model.block_sd or 0.0) ** 2
        z = residual[told] / np.sqrt((variance * freedom)[told])
        gain, predicted = gain[told], means[told]
        varied = np.ptp(gain) > 0 and np.ptp(predicted) > 0
        rank = float(stats.spearmanr(gain, predicted).statistic) if varied else math.nan
        checks.append(
            RockCheck(
                rock,
                len(own),
                float((np.abs(z) <= NORMAL_95).mean()),
                float(np.sqrt((z**2).mean())),
                rank if math.isfinite(rank) else None,
            )
        )
    return checks
