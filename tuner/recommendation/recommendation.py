"""What is recommended, as data: it is read and shown without the model that made it."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import msgspec

from tuner.problem.goal import Direction
from tuner.problem.observations import changes, short

MORE_FAILURES = 2  # from which on one plan fails more often than another: a single one may be chance


@dataclass(frozen=True)
class Limit:
    """The metric that has a limit, at the recommended configuration: means over the training instances, in its unit."""

    metric: str
    direction: Direction
    limit: float
    satisfied: (
        bool  # whether the recommendation can be taken to meet it; else no configuration that was run can
    )
    mean: float
    sd: float
    interval_95: tuple[float, float]
    probability: float  # that the constraint is met
    default_probability: float  # that the default keeps it
    default_mean: float

    @property
    def missed_by(self) -> float:
        """How far the mean is on the wrong side of the limit, in the metric's unit; 0 where it is on the right one."""
        beyond = self.mean - self.limit
        return max(0.0, beyond if self.direction == "minimise" else -beyond)


@dataclass(frozen=True)
class Outlier:
    """A mission whose outcome was winsorised, or that was left out."""

    mission: int  # from 0
    measured: float  # of `Goal.shown`, in its unit
    counts_as: float | None  # None: all others contradict it, and the recommendation was made without it


@dataclass(frozen=True)
class Recommendation:
    """The best configuration of one region of the search space (`tuner.problem.search_space`) that has been run.

    Of those run often enough (``tuner.recommendation.choose``) that are not worse than the best posterior mean it is the one with
    the fewest changes, which may be the default (``keep_default``).

    ``mean``, ``sd`` and ``interval_95`` are about the objective's mean over the training instances, without the noise of
    single missions, in the metric's unit. ``improvement`` and its interval are against the default configuration and
    positive when the recommendation is better, whatever the direction. Intervals and probabilities are Student's t
    (``tuner.surrogate.fit``).

    ``noise_sd``, ``leave_one_out`` and ``outliers`` are of `Goal.shown`: of the quality where photographs are counted.
    """

    name: str  # of the region: tuned-gate, tuned-planner or tuned
    values: dict[str, Any]
    missions: int  # that ran it
    mean: float
    sd: float
    interval_95: tuple[float, float]
    default_values: dict[str, Any]
    default_mean: float
    improvement: float
    improvement_sd: float
    improvement_interval_95: tuple[float, float]
    noise_sd: float  # of one mission, beside its block's offset
    observations: int
    failures: int
    metric: str
    direction: str
    leave_one_out: dict[str, float]
    limit: Limit | None = None  # of the second objective
    outliers: tuple[Outlier, ...] = ()

    def __repr__(self) -> str:
        """``Recommendation(tuned: seeds 14: costs.images 26 in place of 32, +6 [+6, +6])``."""
        named = [f"{path} {short(self.values[path])}" for path in self.changed[:3]]
        change = ", ".join(named) + (f" and {len(self.changed) - 3} more" if len(self.changed) > 3 else "")
        low, high = self.improvement_interval_95
        return (
            f"Recommendation({self.name}: {change or 'keep the default'}: {self.metric} {self.mean:.4g} in place of "
            f"{self.default_mean:.4g}, {self.improvement:+.3g} [{low:+.3g}, {high:+.3g}])"
        )

    @property
    def missions_behind(self) -> int:
        """After how many finished missions it was made, with those that failed or were left out as outliers."""
        return self.observations + self.failures + sum(o.counts_as is None for o in self.outliers)

    @property
    def keep_default(self) -> bool:
        """Whether the answer is to change nothing."""
        return not self.changed

    @property
    def changed(self) -> tuple[str, ...]:
        """Paths whose values differ from the default's and have an effect."""
        return changes(self.values, self.default_values)

    @property
    def missed(self) -> Limit | None:
        """The limit, where the recommendation cannot be taken to meet it."""
        return None if self.limit is None or self.limit.satisfied else self.limit

    def to_dict(self) -> dict[str, Any]:
        return dataclasses.asdict(self)

    @staticmethod
    def from_dict(tree: Mapping[str, Any]) -> Recommendation:
        """Return the inverse of ``to_dict``, after JSON too; ``ValueError`` where it is not."""
        if set(tree) != {field.name for field in dataclasses.fields(Recommendation)}:
            raise ValueError("of another version")
        return msgspec.convert(tree, Recommendation)
