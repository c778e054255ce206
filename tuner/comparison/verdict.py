"""Whether one strategy is better than another: an enumeration with numbers, which pages and terminal put into words."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import StrEnum

from tuner.comparison.statistics import strategy_difference
from tuner.missions.job import Trial
from tuner.problem.intervals import Interval
from tuner.problem.objective import Objective


class Kind(StrEnum):
    """What a paired difference and its 95 % interval say."""

    BETTER = "better"
    WORSE = "worse"  # by more than the margin
    NOT_WORSE = "not worse"  # by more than the margin
    UNDECIDED = "undecided"  # whether it is worse by more than the margin
    NO_DIFFERENCE = "no difference"  # detected
    NO_INTERVAL = "no interval"  # too few missions
    NOT_PAIRED = "not paired"  # no mission in common
    SAME = "same photographs"  # in every mission
    # The constraint, on all, some or none of the rocks:
    KEPT, PARTLY_KEPT, NOT_KEPT = "kept", "partly kept", "not kept"


GOOD = (Kind.BETTER, Kind.NOT_WORSE, Kind.KEPT)
BAD = (Kind.WORSE, Kind.NOT_KEPT)


@dataclass(frozen=True)
class Verdict:
    kind: Kind
    strategy: str
    reference: str
    metric: str
    gain: Interval | None  # positive where it is better; None: not paired; of a constraint the share
    margin: float = 0.0  # what may be lost and still counts as kept, in the metric's unit
    best_control: bool = False  # whether the reference is the best control with as many photographs


def judge(
    records: Sequence[Trial], strategy: str, reference: str, objective: Objective, margin: float = 0.0
) -> Verdict:
    """Return the verdict on ``strategy`` from the blocks that both finished."""
    d = strategy_difference(records, strategy, reference, objective.metric)
    if d is None:
        return Verdict(Kind.NOT_PAIRED, strategy, reference, objective.metric, None, margin)
    gain = d if objective.direction == "maximise" else d.reversed
    return Verdict(kind_of(gain, margin), strategy, reference, objective.metric, gain, margin)


def best_by_gain(records: Sequence[Trial], among: Iterable[str], over: str, objective: Objective) -> str:
    """Return the one of ``among`` with the largest mean gain over ``over``; empty where none of them finished a block that this did.

    Paired, since missions may have failed, and evaluations may have run different plans on different rocks.
    """
    gains = {name: judge(records, name, over, objective).gain for name in among}
    means = {name: gain.mean for name, gain in gains.items() if gain is not None}
    return max(means, key=lambda name: means[name], default="")


def kind_of(gain: Interval, margin: float = 0.0) -> Kind:
    """Return the kind of a difference that is oriented so that positive is better."""
    if gain.low is None or gain.high is None:
        return Kind.NO_INTERVAL
    if gain.low > 0:
        return Kind.BETTER
    if gain.high < -margin:
        return Kind.WORSE
    if not margin:
        return Kind.NO_DIFFERENCE
    return Kind.NOT_WORSE if gain.low >= -margin else Kind.UNDECIDED
