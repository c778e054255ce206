"""What earned the gain of a tuned configuration: its groups of changes, believed by the model and measured by paired missions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from tuner.evaluation.comparison import MetricRow, PairedDifference, strategy_difference
from tuner.missions.job import Trial
from tuner.problem.baselines import TUNED, TUNED_POOL_HYB_H, TUNED_WEIGHTS
from tuner.problem.groups import CHOICE, THRESHOLDS, grouped
from tuner.problem.search_space import Values
from tuner.recommendation.recommendation import Recommendation
from tuner.surrogate.model import InstanceMeanGP
from tuner.surrogate.posterior import interval_95

Gain = tuple[float, tuple[float, float]]  # the gain, positive where better, and its 95 % interval


@dataclass(frozen=True)
class GroupGain:
    """One group of changes, as the model believes it over the training rocks, in the objective's unit."""

    group: str
    paths: tuple[str, ...]
    alone: Gain  # the default with this group's changes, against the default
    rest: Gain  # the recommendation without this group's changes, against the default


def believed_gains(model: InstanceMeanGP, best: Recommendation) -> list[GroupGain]:
    """Return what the model believes of every group of changes of the recommendation, alone and left out."""
    default, groups = best.default_values, grouped(best.changed)
    configurations: list[Values] = [default]
    for paths in groups.values():
        configurations.append({**default, **{path: best.values[path] for path in paths}})
        configurations.append({**best.values, **{path: default[path] for path in paths}})
    belief = model.posterior(configurations)

    def against_default(index: int) -> Gain:
        mean, sd = belief.difference(index, 0)
        return mean, interval_95(mean, sd)

    return [
        GroupGain(group, paths, against_default(1 + 2 * k), against_default(2 + 2 * k))
        for k, (group, paths) in enumerate(groups.items())
    ]


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
