"""What earned the gain of a tuned configuration: its groups of changes, measured by paired missions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from tuner.evaluation.comparison import MetricRow, PairedDifference, strategy_difference
from tuner.missions.job import Trial
from tuner.problem.baselines import CHOICE, THRESHOLDS, TUNED, TUNED_POOL_HYB_H, TUNED_WEIGHTS, grouped


@dataclass(frozen=True)
class Step:
    """One part of the way from Hyb-H to the tuned configuration, by missions on the same rocks and replicates."""

    what: str  # the groups that this step changes
    strategy: str
    reference: str
    difference: PairedDifference | None  # None where the two have no mission in common


def measured_steps(
    records: Sequence[Trial],
    strategies: Sequence[str],
    reference: str,
    row: MetricRow,
    changed: Sequence[str],
) -> list[Step]:
    """Return the gain over ``reference`` step by step: pool (with seeds and stop), weights, thresholds, as far as each was run."""
    groups = grouped(changed)
    elsewhere = [name for name in groups if name not in CHOICE]
    weights = [name for name in groups if name in CHOICE and name != THRESHOLDS]
    thresholds = [name for name in groups if name == THRESHOLDS]
    stages = [(TUNED_POOL_HYB_H, elsewhere), (TUNED_WEIGHTS, weights), (TUNED, thresholds)]
    steps, before, waiting = list[Step](), reference, list[str]()
    for strategy, names in stages:
        waiting += names
        if strategy in strategies and waiting:
            what = " and ".join(waiting)
            difference = strategy_difference(records, strategy, before, row)
            steps.append(Step(what, strategy, before, difference))
            before, waiting = strategy, []
    return steps
