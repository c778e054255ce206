"""What is recommended, as data: it is read and shown without the model that made it."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from nbv.config import IDEAL
from tuner.acquisition.pareto import FrontPoint
from tuner.problem.worlds import World
from tuner.recommendation.inactive import Inactive

MOST_ROCKS = 50  # that a prediction of how many more are needed looks at


@dataclass(frozen=True)
class Candidate:
    """One evaluated configuration in the light of all missions."""

    values: dict[str, Any]
    mean: float  # posterior mean of the objective over the training worlds, metric's unit
    sd: float
    missions: int
    failed: int
    probability_best: float  # among the listed candidates


@dataclass(frozen=True)
class RockRow:
    """The recommended configuration on one training rock, under one of the conditions."""

    rock: str
    missions: int  # of the recommended configuration there
    observed: float | None  # mean over those missions
    predicted: float  # posterior mean there
    condition: str = IDEAL

    @property
    def world(self) -> World:
        """Where that is."""
        return World(self.rock, self.condition)


@dataclass(frozen=True)
class SecondObjective:
    """The second objective at the recommended configuration, where it has a limit."""

    kept: bool  # whether any configuration flown can be taken to keep the limit: then this one
    mean: float  # as the model sees it, oriented so that larger is better
    sd: float
    probability: float  # that the limit is kept
    at_least: float  # the limit, oriented alike
    default_mean: float  # of the default, oriented alike
    default_sd: float


@dataclass(frozen=True)
class Sparsest:
    """The recommended configuration with all parameters but ``kept`` at the default values.

    Differences are in the metric's unit, over the training worlds, positive where this configuration is better, with
    calibrated 95 % intervals.
    """

    values: dict[str, Any]
    kept: tuple[str, ...]  # paths, in the space's order; empty: the default itself
    mean: float  # posterior mean of the objective
    difference: float  # to the recommendation
    difference_interval_95: tuple[float, float]
    improvement: float  # over the default
    improvement_interval_95: tuple[float, float]
    margin: float  # the noise of a mission: a loss above it is unlikely

    @staticmethod
    def from_dict(tree: Mapping[str, Any]) -> Sparsest:
        """The inverse of ``dataclasses.asdict``, after JSON too."""
        pairs = ("kept", "difference_interval_95", "improvement_interval_95")
        return Sparsest(**{**tree, **{key: tuple(tree[key]) for key in pairs}})


@dataclass(frozen=True)
class NextRock:
    """The gain over the default on a new rock, metric's unit, positive where the recommendation is better."""

    gain: float
    interval_95: tuple[float, float]
    between_rocks_sd: float  # of the gain, from rock to rock
    per_rock: dict[str, float]  # posterior means of the gain on the training rocks
    against: tuple[str, ...]  # training rocks that the recommendation probably makes worse
    more_rocks: (
        int | None
    )  # that tell the mean gain over such rocks from 0, if it is as large as believed; None: too many

    def warnings(self) -> list[str]:
        """Where training rocks disagree, and how many more would settle it: a sentence each, none where all is well."""
        said = []
        if self.against:
            names = ", ".join(Path(rock).stem for rock in self.against)
            said.append(f"Training rocks disagree: it is probably worse than the default on {names}.")
        if self.more_rocks is None:
            said.append(
                f"Not even {MOST_ROCKS} training rocks would tell the mean gain over such rocks from 0."
            )
        elif self.more_rocks:
            more = (
                "1 more training rock" if self.more_rocks == 1 else f"{self.more_rocks} more training rocks"
            )
            said.append(f"{more} would tell the mean gain over such rocks from 0, if it is as large as that.")
        return said

    @staticmethod
    def from_dict(tree: Mapping[str, Any]) -> NextRock:
        """The inverse of ``dataclasses.asdict``, after JSON too."""
        return NextRock(
            **{**tree, "interval_95": tuple(tree["interval_95"]), "against": tuple(tree["against"])}
        )


@dataclass(frozen=True)
class Recommendation:
    """The evaluated configuration with the best posterior mean, not the luckiest observation.

    ``mean``, ``sd`` and ``interval_95`` are about the mean over the training worlds, without the noise of single
    missions, in the metric's unit. ``improvement`` and its interval are against the default configuration and
    positive when the recommendation is better, whatever the direction. All intervals and probabilities are calibrated
    (``tuner.surrogate.forward_check``). ``top`` is the ranking that decided: what may be recommended
    (``tuner.recommendation.eligible``), best posterior mean first. ``sparsest`` keeps only what is needed of it, and
    ``inactive`` are the parameters of ``values`` whose numbers say nothing.
    """

    values: dict[str, Any]
    mean: float
    sd: float
    interval_95: tuple[float, float]
    probability_best: float
    top: list[Candidate]
    per_rock: list[RockRow]
    default_values: dict[str, Any]
    default_mean: float
    default_sd: float
    improvement: float
    improvement_sd: float
    improvement_interval_95: tuple[float, float]
    probability_better_than_default: float
    noise_sd: float  # of one mission, beside its block's offset
    block_sd: float | None  # of the offsets that (world, replicate) blocks share; None: not told from noise
    observations: int
    failures: int
    metric: str
    direction: str
    lengthscales: dict[str, float]
    leave_one_out: dict[str, float]
    calibration: dict[str, float | None]  # how missions were predicted before they were flown
    sparsest: Sparsest | None = None  # None: nobody asked
    inactive: list[Inactive] = field(default_factory=list)
    next_rock: NextRock | None = None  # None: nobody asked, or it is the default
    limit: SecondObjective | None = None
    front: list[FrontPoint] = field(default_factory=list)  # where there is a second objective

    def to_dict(self) -> dict[str, Any]:
        """JSON form."""
        return dataclasses.asdict(self)

    @staticmethod
    def from_dict(tree: Mapping[str, Any]) -> Recommendation:
        """The inverse of ``to_dict``, after JSON too; ``TypeError`` or ``KeyError`` where it is not."""
        return Recommendation(
            **{
                **tree,
                "interval_95": tuple(tree["interval_95"]),
                "improvement_interval_95": tuple(tree["improvement_interval_95"]),
                "top": [Candidate(**candidate) for candidate in tree["top"]],
                "per_rock": [RockRow(**row) for row in tree["per_rock"]],
                "sparsest": None if tree["sparsest"] is None else Sparsest.from_dict(tree["sparsest"]),
                "inactive": [Inactive(**found) for found in tree["inactive"]],
                "next_rock": None if tree["next_rock"] is None else NextRock.from_dict(tree["next_rock"]),
                "limit": None if tree["limit"] is None else SecondObjective(**tree["limit"]),
                "front": [FrontPoint(**point) for point in tree["front"]],
            }
        )
