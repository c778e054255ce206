"""Whether one strategy is better than another: an enumeration with numbers, which pages and terminal put into words."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

from tuner.comparison.statistics import strategy_difference
from tuner.missions.job import Trial
from tuner.problem.intervals import Interval
from tuner.problem.objective import Objective


class Kind(StrEnum):
    """What a paired difference and its 95 % interval say."""

    BETTER = "better"
    WORSE = "worse"
    NO_DIFFERENCE = "no difference"  # detected
    NO_INTERVAL = "no interval"  # too few missions
    NOT_PAIRED = "not paired"  # no mission in common
    SAME = "same photographs"  # in every mission


@dataclass(frozen=True)
class Verdict:
    kind: Kind
    strategy: str
    reference: str
    metric: str
    gain: Interval | None  # positive where it is better; None: not paired


def judge(records: Sequence[Trial], strategy: str, reference: str, objective: Objective) -> Verdict:
    """Return the verdict on ``strategy`` from the blocks that both finished."""
    d = strategy_difference(records, strategy, reference, objective.metric)
    if d is None:
        return Verdict(Kind.NOT_PAIRED, strategy, reference, objective.metric, None)
    gain = d if objective.direction == "maximise" else d.reversed
    return Verdict(kind_of(gain), strategy, reference, objective.metric, gain)


def kind_of(gain: Interval) -> Kind:
    """Return the kind of a difference that is oriented so that positive is better."""
    if gain.low is None or gain.high is None:
        return Kind.NO_INTERVAL
    return Kind.BETTER if gain.low > 0 else Kind.WORSE if gain.high < 0 else Kind.NO_DIFFERENCE
