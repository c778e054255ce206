"""The confirmation stage: the last share of a budget flies the best few configurations side by side.

The search leaves a favourite that owes some of its lead to luck. The stage flies the finalists (the best by
posterior mean, and the default configuration, against which the gain is stated) on fresh replicates, all of
them on every slot, so that what a (rock, replicate) slot does to everybody cancels in their differences.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import t as student_t

from nbv.types import Floats
from tuner.problem.observations import Observation, Proposal
from tuner.problem.search_space import SearchSpace, Values

MAX_SHARE = 0.5
MAX_FINALISTS = 4  # the default configuration included
# In length scales: the outcomes of two such configurations correlate by 0.93 in the surrogate (Matern-5/2).
NEARLY_THE_SAME = 0.3


def confirmation_missions(budget: int, share: float) -> int:
    """Missions of a budget that confirm; the search has the others."""
    return round(budget * share)


def finalist_count(missions: int, rocks: int) -> int:
    """Configurations to confirm: as many as can meet once on every rock, 2 to ``MAX_FINALISTS``."""
    return max(2, min(MAX_FINALISTS, missions // rocks))


def choose_finalists(
    space: SearchSpace,
    ranked: Sequence[Mapping[str, Any]],
    default: Mapping[str, Any],
    count: int,
    lengthscales: Mapping[str, float] | None = None,
) -> list[Values]:
    """The first of ``ranked`` (best first), with the default configuration among them; at most ``count``.

    With ``lengthscales`` (unit-cube units, by ordered parameter) a configuration that the model takes for nearly
    the same as an earlier finalist is passed over: missions that tell the two apart would be wasted.
    """
    home = space.to_unit(default)
    scale = np.array([(lengthscales or {}).get(p.path, 0.0) for p in space.parameters])
    chosen: list[Values] = []
    for values in ranked:
        at = space.to_unit(values)
        if np.allclose(at, home, rtol=0, atol=1e-9):
            continue
        if all(_distance(at, space.to_unit(other), scale) > NEARLY_THE_SAME for other in chosen):
            chosen.append(dict(values))
    return [*chosen[: count - 1], dict(default)]


def _distance(one: Floats, two: Floats, scale: Floats) -> float:
    """In length scales; parameters without one (choices, or all of them) make a difference if they differ."""
    gap = np.abs(one - two)
    if np.any(gap[scale <= 0] > 1e-9):
        return math.inf
    return float(np.linalg.norm(gap[scale > 0] / scale[scale > 0]))


def schedule(
    finalists: Sequence[Mapping[str, Any]], rocks: Sequence[str], first_replicate: int, missions: int
) -> list[Proposal]:
    """All confirmation missions in the order in which they are flown.

    A round is one slot flown by every finalist; rounds take the rocks in turn, with a new replicate whenever
    all rocks have been visited. The last round may be incomplete.
    """
    proposals = []
    for i in range(missions):
        turn, who = divmod(i, len(finalists))
        lap, place = divmod(turn, len(rocks))
        why = {"sampler": "confirmation", "phase": "confirmation", "round": turn, "finalist": who}
        proposals.append(Proposal(dict(finalists[who]), why, rocks[place], first_replicate + lap))
    return proposals


@dataclass(frozen=True)
class PairedGain:
    """A finalist against the default configuration on common slots, by the missions alone, without a model."""

    values: dict[str, Any]
    missions: int  # feasible confirmation missions
    pairs: int  # slots on which both succeeded
    gain: float | None  # mean difference, positive when better than the default; None without pairs
    gain_interval_95: tuple[float, float] | None  # Student's t; None below 2 pairs


def paired_gain(
    values: Mapping[str, Any], own: Sequence[Observation], reference: Sequence[Observation]
) -> PairedGain:
    """Compare the confirmation missions ``own`` of one finalist with those of the default configuration."""
    of_slot = {(o.rock, o.replicate): o.outcome for o in reference if o.outcome is not None}
    mine = {(o.rock, o.replicate): o.outcome for o in own if o.outcome is not None}
    differences = np.array([y - of_slot[slot] for slot, y in mine.items() if slot in of_slot])
    n = len(differences)
    gain = float(differences.mean()) if n else None
    interval = None
    if gain is not None and n >= 2:
        half = float(student_t.ppf(0.975, n - 1)) * float(differences.std(ddof=1)) / math.sqrt(n)
        interval = (gain - half, gain + half)
    return PairedGain(dict(values), len(mine), n, gain, interval)
